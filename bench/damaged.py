"""What `bench.faults` damages, kind by kind: a whole file, and who reads it, as far as a user would."""

import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.mutations import Mutate, of_bytes

ROOT = Path(__file__).resolve().parents[1]
TINY = ROOT / "tests" / "data" / "tiny"
BUNDLE, SEQUENCE = TINY / "bundle", TINY / "scans" / "sequences" / "00"
SHIPPED = ROOT / "models" / "rt"

Reader = Callable[[Path], object]


class Target(NamedTuple):
    """A file that may be replaced by a damaged one, and what reads it."""

    path: Path
    data: bytes  # of the whole one
    read: Reader


class Kind(NamedTuple):
    """Something that is damaged."""

    target: Callable[[], Iterator[Target]]
    mutate: Mutate = of_bytes
    share: int = 10  # of all inputs: what takes long has a small one


def of_bundle(name: str, source: Path = BUNDLE) -> Iterator[Target]:
    """A file of a bundle, whose manifest speaks of it as it is."""
    from runtime.bundle.loading import load_bundle, sha256_of
    from runtime.bundle.manifest import MANIFEST
    from runtime.compute.workers import Workers
    from runtime.head.numba_engine import PointHeadEngine
    from runtime.image.image_net import ImageNet

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(shutil.copytree(source, Path(temporary) / "bundle"))

        def read(path: Path) -> None:
            if name != MANIFEST:
                values = json.loads((source / MANIFEST).read_text())
                values["files"][name] |= {"sha256": sha256_of(path), "bytes": path.stat().st_size}
                (folder / MANIFEST).write_text(json.dumps(values))
            bundle = load_bundle(folder)
            if name.endswith(".onnx"):
                net = ImageNet.of(bundle, "int8" if "int8" in name else "float32", threads=1)
                net.run(np.zeros(bundle.manifest.view(bundle.manifest.sensor).shape, np.float32))
            elif name == "point_head.npz" and bundle.manifest.point_head is not None:
                engine = PointHeadEngine(bundle.point_head(), bundle.manifest.point_head, Workers(1))
                engine.refine(
                    XYZ, np.ones(len(XYZ), np.bool_), np.ones((len(XYZ), engine.config.in_channels), np.float32)
                )

        yield Target(folder / name, (source / name).read_bytes(), read)


XYZ = np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32)
SCAN = np.random.default_rng(0).normal(size=(200, 4)).astype(np.float32)


def of_file(name: str, data: bytes, read: Reader) -> Iterator[Target]:
    """A file by itself."""
    with tempfile.TemporaryDirectory() as folder:
        yield Target(Path(folder) / name, data, read)


def scan(suffix: str, encoding: str = "") -> Iterator[Target]:
    """A scan in a file of its own; read, counted, and written with some of its points."""
    from runtime.recordings.formats.registry import count_points, kept_points, read_cloud
    from tests.support.scan_writers import write_las, write_pcd, write_ply

    def read(path: Path) -> None:
        cloud = read_cloud(path)
        count_points(path)
        kept_points(path, np.arange(len(cloud.data)) % 2 == 0)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"000000{suffix}"
        if suffix == ".npy":
            np.save(path, SCAN)
        elif suffix == ".bin":
            SCAN.tofile(path)
        elif suffix in (".las", ".laz"):
            write_las(path, SCAN)
        elif suffix == ".feather":
            import pyarrow
            from pyarrow import feather

            columns = zip(("x", "y", "z", "intensity"), SCAN.T, strict=True)
            feather.write_feather(pyarrow.table({name: np.ascontiguousarray(values) for name, values in columns}), path)
        else:
            (write_pcd if suffix == ".pcd" else write_ply)(path, SCAN, encoding)
        yield from of_file(path.name, path.read_bytes(), read)


def poses(name: str) -> Iterator[Target]:
    """A pose file."""
    from runtime.recordings.pose_files import checked
    from runtime.recordings.pose_table import read_pose_table

    def read(path: Path) -> None:
        found = read_pose_table(path).poses
        checked(found, {}, [str(index) for index in range(len(found))], skip_broken=True)

    lines = (SEQUENCE / "poses.txt").read_text()
    if name != "kitti":
        rows = [f"{i} {i / 2} 0 0 0 0 0 1" for i in range(9)]
        lines = "\n".join(
            rows if name == "tum" else ["time,x,y,z,qx,qy,qz,qw", *(row.replace(" ", ",") for row in rows)]
        )
    yield from of_file("poses.csv" if name == "table" else "poses.txt", lines.encode(), read)


def labels() -> Iterator[Target]:
    """A label file."""
    from runtime.recordings.labels import read_prediction, read_truth

    path = next((SEQUENCE / "labels").glob("*.label"))

    def read(path: Path) -> None:
        read_truth(path)
        read_prediction(path)

    yield from of_file(path.name, path.read_bytes(), read)


def sensor() -> Iterator[Target]:
    """A sensor of a user's own, and an image of it."""
    from runtime.image.projection import pixel_scale
    from runtime.sensors.registry import open_sensor

    values = {
        "name": "own",
        "elevations": [2.0, 0.0, -3.0, -9.0],
        "azimuth_steps": 900,
        "reach": 90.0,
        "max_range": 80.0,
    }
    yield from of_file("own.json", json.dumps(values).encode(), lambda path: pixel_scale(open_sensor(path).range_image))


def checkpoint() -> Iterator[Target]:
    """A checkpoint, to train on from and to export."""
    from export.checkpoint.published import understand
    from export.checkpoint.reader import read_tensors
    from mos_model.networks.checkpoint import read as read_own

    def read(path: Path) -> None:
        understand(read_tensors(path), path, None)
        read_own(path).modules()

    yield from of_file("checkpoint.pt", (TINY / "checkpoint.pt").read_bytes(), read)

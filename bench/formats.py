"""Is a drive the same drive in every format: labels that differ, and what reading costs: `python -m bench.formats`."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import brief, save, show, summary
from runtime.commands.handler import run_alone
from runtime.predict import predict
from runtime.recordings.labels import read_prediction
from runtime.recordings.recording import Indexed, Options
from runtime.recordings.registry import open_recording
from runtime.runner import MosRunner
from tests.support.bag_writers import KINDS, BagWriter
from tests.support.scan_writers import write_las, write_pcd, write_ply

FOLDERS: dict[str, tuple[str, Callable[..., None]]] = {
    **{f"PCD, {one}": (".pcd", partial(write_pcd, encoding=one)) for one in ("ascii", "binary", "binary_compressed")},
    **{f"PLY, {one}": (".ply", partial(write_ply, encoding=one)) for one in ("ascii", "binary_little_endian")},
    "LAS": (".las", write_las),
    "LAZ": (".laz", write_las),
}
PERIOD = 0.1  # s from scan to scan
BASE = np.eye(4)  # T_base_lidar, in the bag with TF
BASE[:3, 3] = 0.8, 0.0, 1.7


def bench(
    sequence: Annotated[Path, typer.Option(help="A KITTI sequence")],
    bundle: Annotated[Path | None, typer.Argument(help="Bundle", show_default="the default one")] = None,
    limit: Annotated[int | None, typer.Option(help="Only the first scans")] = None,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Labels with the same pose file in every format, and with poses of a topic, against those of the .bin files."""
    given = open_recording(sequence, Options(limit=limit))
    options = Options(sequence / "poses.txt", sequence / "calib.txt", limit=limit)
    runner = MosRunner(bundle, threads=threads)
    rows: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        base, _ = labels_of(given, runner, Path(folder) / "base")
        for name, recording in written(given, Path(folder), options):
            labels, wait = labels_of(recording, runner, Path(folder) / name)
            different = np.concatenate([one != other for one, other in zip(labels, base, strict=True)])
            read = [one for _ in range(3) for one in seconds_to_read(recording)]
            share = 100 * float(different.mean())
            rows[name] = {"labels that differ, %": share, "wait in mos run, ms": 1e3 * wait, **summary(read)}
    show(f"{runner.bundle.manifest.name}, {len(given)} scans; ms to read one", brief(rows))
    save(out, threads, {"scans": len(given), "points": sum(map(given.count, range(len(given)))), "formats": rows})


def written(given: Indexed, folder: Path, options: Options) -> Iterator[tuple[str, Indexed]]:
    """The drive in every format, one after the other."""
    yield "KITTI, .bin", open_recording(given.source, options)
    for name, (suffix, write) in FOLDERS.items():
        place = folder / name.replace(" ", "")
        place.mkdir()
        for scan in given:
            write(place / f"{scan.key}{suffix}", scan.data)
        yield name, open_recording(place, options)
    for kind in KINDS:
        path = folder / (f"{kind}.bag" if kind == "bag" else kind)
        with BagWriter(path, kind) as bag:
            for index, scan in enumerate(given):
                bag.cloud(scan.data, PERIOD * index)
                bag.pose(scan.known_pose(), PERIOD * index)
        yield f"bag, .{kind}", open_recording(path, options)
    yield "bag, .mcap, its odometry", open_recording(path, Options(limit=options.limit))
    with BagWriter(folder / "tf", "mcap") as bag:
        bag.transform(BASE, 0.0, "base_link", "lidar", topic="/tf_static")
        for index, scan in enumerate(given):
            bag.cloud(scan.data, PERIOD * index)
            bag.transform(scan.known_pose() @ np.linalg.inv(BASE), PERIOD * index, "odom", "base_link")
    yield "bag, .mcap, its TF", open_recording(folder / "tf", Options(limit=options.limit))


def labels_of(recording: Indexed, runner: MosRunner, out: Path) -> tuple[list[np.ndarray], float]:
    """(T, N) of `mos run`, and the seconds that it waits for a scan, at the median."""
    done = predict(recording, runner, out)
    return [read_prediction(file) for file in sorted(done.folder.iterdir())], float(np.median(done.latency["read"]))


def seconds_to_read(recording: Indexed) -> list[float]:
    """Of each scan, one after the other."""
    found, scans = [], recording.scans()
    while True:
        started = time.perf_counter()
        if next(scans, None) is None:
            return found
        found.append(time.perf_counter() - started)


if __name__ == "__main__":
    sys.exit(run_alone(bench, "formats"))

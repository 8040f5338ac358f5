"""Damaged files of every kind, by seeded mutation of whole ones: `python -m bench.faults`.

Each kind has a process of its own, so that a crash is seen. What is read must be read, or refused with a `MosError`.
"""

import json
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bench.report import show
from runtime.commands.handler import run_alone

ROOT = Path(__file__).resolve().parents[1]
BUNDLE = ROOT / "tests" / "data" / "tiny" / "bundle"
SEQUENCE = ROOT / "tests" / "data" / "tiny" / "scans" / "sequences" / "00"
ODD = (
    "1e400",
    "-1",
    "0",
    "null",
    "NaN",
    "[[[[]]]]",
    '"\\ud800"',
    "1e-300",
    "9" * 400,
    "true",
    "{}",
    "3.5",
    "nan",
    "\x1b[2J",
)
LONGEST = 600  # s that a process may take without an answer: it hangs

Reader = Callable[[Path], object]


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The same with up to four changes: bits, spans that are gone, doubled or random, an odd word, an early end."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(changed) + 1))
        span = int(min(rng.integers(1, 64), len(changed) - at))
        kind = rng.integers(6)
        if kind == 0 and span:
            changed[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del changed[at : at + span]
        elif kind == 2:
            changed[at:at] = changed[at : at + span]
        elif kind == 3:
            changed[at : at + span] = rng.bytes(span)
        elif kind == 4:
            changed[at : at + span] = ODD[int(rng.integers(len(ODD)))].encode()
        elif rng.random() < 0.3:
            del changed[at:]
    return bytes(changed)


def of_bundle(name: str) -> Iterator[tuple[Path, bytes, Reader]]:
    """A file of the tiny bundle, whose manifest speaks of it as it is."""
    from runtime.bundle.loading import load_bundle, sha256_of
    from runtime.bundle.manifest import MANIFEST
    from runtime.compute.workers import Workers
    from runtime.head.numba_engine import PointHeadEngine
    from runtime.image.image_net import ImageNet

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(shutil.copytree(BUNDLE, Path(temporary) / "bundle"))

        def read(path: Path) -> None:
            if name != MANIFEST:
                values = json.loads((BUNDLE / MANIFEST).read_text())
                values["files"][name] |= {"sha256": sha256_of(path), "bytes": path.stat().st_size}
                (folder / MANIFEST).write_text(json.dumps(values))
            bundle = load_bundle(folder)
            if name == "image_net.onnx":
                net = ImageNet.of(bundle, threads=1)
                net.run(np.zeros(bundle.manifest.view(bundle.manifest.sensor).shape, np.float32))
            elif name == "point_head.npz" and bundle.manifest.point_head is not None:
                PointHeadEngine(bundle.point_head(), bundle.manifest.point_head, Workers(1))

        yield folder / name, (BUNDLE / name).read_bytes(), read


def of_file(name: str, data: bytes, read: Reader) -> Iterator[tuple[Path, bytes, Reader]]:
    """A file by itself."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder) / name, data, read


def scans(suffix: str) -> Iterator[tuple[Path, bytes, Reader]]:
    """A scan in one of the formats that need no other package."""
    from runtime.recordings.formats.registry import read_cloud
    from tests.support.scan_writers import write_pcd, write_ply

    scan = np.random.default_rng(0).normal(size=(200, 4)).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"000000{suffix}"
        if suffix == ".npy":
            np.save(path, scan)
        elif suffix == ".bin":
            scan.tofile(path)
        else:
            (write_pcd if suffix == ".pcd" else write_ply)(path, scan, "binary" if suffix == ".pcd" else "ascii")
        yield from of_file(path.name, path.read_bytes(), read_cloud)


def poses() -> Iterator[tuple[Path, bytes, Reader]]:
    """A pose file."""
    from runtime.recordings.pose_files import checked
    from runtime.recordings.pose_table import read_pose_table

    def read(path: Path) -> object:
        found = read_pose_table(path).poses
        return checked(found, {}, [str(index) for index in range(len(found))], skip_broken=True)

    yield from of_file("poses.txt", (SEQUENCE / "poses.txt").read_bytes(), read)


def labels() -> Iterator[tuple[Path, bytes, Reader]]:
    """A label file."""
    from runtime.recordings.labels import read_truth

    path = next((SEQUENCE / "labels").glob("*.label"))
    yield from of_file(path.name, path.read_bytes(), read_truth)


KINDS: dict[str, Callable[[], Iterator[tuple[Path, bytes, Reader]]]] = {
    "manifest": lambda: of_bundle("manifest.json"),
    "network": lambda: of_bundle("image_net.onnx"),
    "weights": lambda: of_bundle("point_head.npz"),
    "poses": poses,
    "labels": labels,
    **{f"scan {suffix}": (lambda suffix=suffix: scans(suffix)) for suffix in (".bin", ".npy", ".pcd", ".ply")},
}


def try_kind(kind: str, seed: int, count: int) -> None:
    """In a process of its own: a line of JSON for each input that is neither read nor refused, and one at the end."""
    from runtime.errors import MosError

    warnings.simplefilter("ignore")
    refused = 0
    for path, data, read in KINDS[kind]():
        for number in range(count):
            typer.echo(json.dumps({"number": number}))
            path.write_bytes(mutated(data, np.random.default_rng((seed, number))))
            try:
                read(path)
            except MosError:
                refused += 1
            except Exception as error:
                typer.echo(json.dumps({"failed": f"{type(error).__name__}: {error}"[:200], "of": number}))
    typer.echo(json.dumps({"refused": refused}))


def bench(
    seed: int = 0,
    count: Annotated[int, typer.Option(help="Inputs of each kind")] = 200,
    kind: Annotated[list[str] | None, typer.Option(help="Only this kind; may be repeated")] = None,
    alone: Annotated[bool, typer.Option(hidden=True)] = False,
) -> None:
    """Read damaged files of every kind, and count those that are neither read nor refused."""
    if alone:
        return try_kind((kind or [])[0], seed, count)
    rows, failures = {}, []
    for name in kind or KINDS:
        began = time.perf_counter()
        command = [sys.executable, "-m", "bench.faults", "--alone", "--kind", name, "--seed", str(seed)]
        try:
            done = subprocess.run(
                [*command, "--count", str(count)],
                cwd=ROOT,
                capture_output=True,
                text=True,
                timeout=LONGEST,
                check=False,
            )
            code, said = done.returncode, done.stdout
        except subprocess.TimeoutExpired as late:
            code, said = 1, (late.stdout or b"").decode()
        lines = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        failed = [line for line in lines if "failed" in line]
        if code or not lines or "refused" not in lines[-1]:
            tried = [line["number"] for line in lines if "number" in line]
            failed.append({"failed": f"ended with {code}, or hung", "of": tried[-1] if tried else 0})
        failures += [f"{name}, seed {seed}, number {line['of']}: {line['failed']}" for line in failed]
        refused = next((line["refused"] for line in lines if "refused" in line), 0)
        rows[name] = {
            "inputs": sum("number" in line for line in lines),
            "refused": refused,
            "failures": len(failed),
            "s": round(time.perf_counter() - began, 1),
        }
    show("damaged files", rows)
    for line in failures:
        typer.echo(line)
    raise typer.Exit(1 if failures else 0)


if __name__ == "__main__":
    sys.exit(run_alone(bench, "faults"))

"""Time of the point head beside the machine's peak, refinement, cost against size, memory.

python -m bench.point_head --sequence ../shared/data/kitti/sequences/00 --labelled .../sequences/90 --out head.json
"""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import ROOT, interleaved, save, show, summary
from bench.scans import load_frames
from runtime.head_config import FULL, LITE
from runtime.inputs import InputBuilder
from runtime.point_head import FeatureMap, PointHeadEngine, fold
from runtime.sensor import HISTORY, Residual, Sensor
from runtime.workers import Workers

HEADS = {"lite": LITE, "full": FULL}
PEAK = 2048  # rows and columns of the matrix product that is taken for the machine's peak


def reference_weights(name: str) -> dict[str, np.ndarray]:
    """The published layout with random weights (seed 2026)."""
    path = ROOT / "tests" / "data" / "published" / "reference_weights.py"
    spec = importlib.util.spec_from_file_location("reference_weights", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return dict(module.reference_state_dict(f"point_head_{name}", 2026))


def brief(rows: dict[str, Any]) -> dict[str, Any]:
    """Rows of a table without what is only in the JSON file."""
    return {
        name: {k: v for k, v in row.items() if k not in ("min", "max", "runs", "p95")} for name, row in rows.items()
    }


def head(name: str, threads: int, **changes: Any) -> PointHeadEngine:
    config = replace(HEADS[name], **changes)
    return PointHeadEngine(fold(reference_weights(name), config), config, Workers(threads))


class Scan:
    """Arguments of `refine` for a scan, with random image features."""

    def __init__(self, points: np.ndarray) -> None:
        sensor, random = Sensor(), np.random.default_rng(0)
        image = InputBuilder(sensor, Residual(), Workers(1)).build(points, [None] * HISTORY, [None] * HISTORY)
        features = random.normal(size=(32, sensor.height, sensor.width)).astype(np.float32)
        self.xyz, self.valid = np.ascontiguousarray(points[:, :3]), image.pixel >= 0
        self.args = self.xyz, self.valid, FeatureMap(features, image.u, image.v)


def peak() -> Callable[[], object]:
    """A single-precision matrix product with as many threads as NumPy's BLAS takes."""
    a, b, c = (np.ones((PEAK, PEAK), np.float32) for _ in range(3))
    return lambda: np.matmul(a, b, out=c)


def whole_scan(scan: Scan, threads: int, rounds: int) -> dict[str, Any]:
    """Both heads on a whole scan, and the matrix product in the same run."""
    engines = {name: head(name, threads) for name in HEADS}
    tasks: dict[str, Callable[[], object]] = {
        name: lambda e=engine: e.refine(*scan.args) for name, engine in engines.items()
    }
    seconds = interleaved({**tasks, "sgemm": peak()}, rounds)
    sgemm = 2 * PEAK**3 / float(np.median(seconds["sgemm"])) / 1e9
    rows: dict[str, Any] = {}
    for name, engine in engines.items():
        taken, steps = float(np.median(seconds[name])), engine.timing
        rate = 2 * engine.multiply_adds / taken / 1e9
        rows[name] = {
            **summary(seconds[name]),
            "GFLOP/s": rate,
            "% of sgemm": 100 * rate / sgemm,
            "convs alone %": 100 * rate / sgemm * sum(steps.values()) / steps["convolutions"],
            "% not convs": 100 * (1 - steps["convolutions"] / sum(steps.values())),
            "buffers MB": engine.workspace / 1e6,
        }
    rows["sgemm"] = {**summary(seconds["sgemm"]), "GFLOP/s": sgemm}
    show(f"whole scan, {len(scan.xyz)} points, {engine.voxels} voxels, ms", brief(rows))
    return rows


def refinement(scan: Scan, candidates: np.ndarray, threads: int, rounds: int) -> dict[str, Any]:
    """Refining candidates against a full run: time, and what becomes of their labels."""
    engine, rows = head("lite", threads), {}
    full = engine.refine(*scan.args)
    halos: dict[str, tuple[Any, ...]] = {
        "whole scan": (),
        "default halo": (candidates,),
        "exact halo": (candidates, "exact"),
        "no candidates": (np.zeros_like(candidates),),
    }
    tasks = {name: (lambda a=args: engine.refine(*scan.args, *a)) for name, args in halos.items()}
    seconds = interleaved(tasks, rounds)
    whole = float(np.median(seconds["whole scan"]))
    for name, task in tasks.items():
        result = task()
        kept = candidates & np.isfinite(result[:, 0])
        rows[name] = {
            **summary(seconds[name]),
            "% of whole": 100 * float(np.median(seconds[name])) / whole,
            "voxels": engine.voxels,
        }
        if kept.any():
            rows[name]["% same label"] = 100 * float((result[kept].argmax(1) == full[kept].argmax(1)).mean())
            rows[name]["max difference"] = f"{np.abs(result[kept] - full[kept]).max():.1e}"
    show(f"refinement (lite), {100 * candidates.mean():.2f} % of the points are candidates, ms", brief(rows))
    return rows


def resident() -> float:
    """Resident memory of this process in MB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def memory(scans: list[Scan], threads: int, count: int) -> dict[str, Any]:
    """Resident memory after `count` scans against that after 50: a sequence forwards and backwards."""
    engine = head("lite", threads)
    there_and_back = scans + scans[-2:0:-1]
    early = 0.0
    for i in range(count):
        engine.refine(*there_and_back[i % len(there_and_back)].args)
        if i == min(49, count - 1):
            early = resident()
    row = {"after scan 50, MB": early, "at the end, MB": resident(), "scans": count}
    show("memory (lite)", {"resident": row})
    return row


def sizes(scans: list[Scan], threads: int, rounds: int, plot: Path | None) -> dict[str, Any]:
    """Cost against the number of voxels: scans merged side by side in one frame, and parts of one."""
    engine, rows = head("lite", threads), {}
    merged = np.concatenate([scan.xyz[scan.valid] + np.float32(0.013 * i) for i, scan in enumerate(scans)])
    merged = np.pad(merged, ((0, 0), (0, 1)))
    for wanted in (1_000, 10_000, 50_000, 100_000, 200_000, 300_000, 500_000):
        points = merged[: int(wanted * 1.35)]
        near = points[np.argsort(np.abs(points[:, :2]).max(axis=1))] if wanted < 50_000 else points
        scan = Scan(near[:wanted] if wanted < 50_000 else points)
        seconds = interleaved({"": lambda s=scan: engine.refine(*s.args)}, rounds)[""]
        taken = float(np.median(seconds))
        rows[str(engine.voxels)] = {
            **summary(seconds),
            "ps per multiply-add": 1e12 * taken / engine.multiply_adds,
            "G multiply-adds": engine.multiply_adds / 1e9,
        }
    show("cost against size (lite), by number of voxels, ms", brief(rows))
    if plot is not None:
        draw(rows, plot)
    return rows


def draw(rows: dict[str, Any], path: Path) -> None:
    """Time against voxels, both logarithmic."""
    from matplotlib.figure import Figure

    figure = Figure((6, 4), layout="constrained")
    axes = figure.subplots()
    axes.loglog([int(v) for v in rows], [row["median"] for row in rows.values()], "o-")
    axes.set(xlabel="voxels of 5 cm", ylabel="ms per scan", title="lite point head")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    labelled: Annotated[Path | None, typer.Option(help="A sequence with labels, for the candidates")] = None,
    threads: int = 2,
    rounds: int = 7,
    scans: Annotated[int, typer.Option(help="Scans of the memory test")] = 1000,
    plot: Annotated[Path | None, typer.Option(help="PNG of cost against size")] = None,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """All tables of the point head."""
    several = [Scan(points) for points, _ in load_frames(sequence, 8)]
    results: dict[str, Any] = {"whole_scan": whole_scan(several[0], threads, rounds)}
    frame, moving = several[0], several[0].valid & (np.abs(several[0].xyz - several[0].xyz[1000]).max(axis=1) < 2)
    if labelled is not None:
        frame, moving = busiest(labelled)
    results["refinement"] = refinement(frame, moving, threads, rounds)
    results["sizes"] = sizes(several, threads, max(3, rounds // 2), plot)
    if scans:
        results["memory"] = memory(several, threads, scans)
    save(out, threads, results)


def busiest(sequence: Path) -> tuple[Scan, np.ndarray]:
    """The scan of a sequence with the most moving points, at most 2 % of it, and which they are."""
    best, most = None, -1
    for path in sorted((sequence / "labels").glob("*.label")):
        moving = (np.fromfile(path, np.uint32) & 0xFFFF) >= 251
        if most < moving.sum() <= 0.02 * len(moving):
            best, most = (path, moving), int(moving.sum())
    if best is None:
        raise typer.BadParameter(f"no scan of {sequence} has labels with at most 2 % of moving points")
    path, moving = best
    points = np.fromfile(sequence / "velodyne" / f"{path.stem}.bin", np.float32).reshape(-1, 4)
    return Scan(points), moving & points[:, :3].any(axis=1)


if __name__ == "__main__":
    typer.run(bench)

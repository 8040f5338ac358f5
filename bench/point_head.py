"""The point head beside the machine's peak and other libraries, refinement, cost against size, memory: one table.

python -m bench.point_head --sequence ../shared/data/kitti/sequences/00 --labelled .../sequences/90 --out head.json

About seven minutes on two cores. spconv and PyTorch are compared with where they are installed.
"""

import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench import sparse_layer
from bench.head_agreement import agreement
from bench.head_growth import memory, sizes
from bench.head_scans import HEADS, Refinement, Scan, busiest, make_head, sgemm
from bench.report import brief, interleaved, save, show, summary
from bench.scans import Frame, load_frames
from runtime.commands.handler import run_alone

PARTS = ("heads", "layers", "refinement", "sizes", "memory")
PEAK = 2048  # rows and columns of the matrix product that is taken for the machine's peak


def heads(scan: Scan, threads: int, rounds: int) -> dict[str, Any]:
    """Both heads on a whole scan, and the matrix product in the same run."""
    tasks = {name: Refinement(make_head(name, threads), scan.args) for name in HEADS}
    seconds = interleaved({**tasks, "sgemm": sgemm(PEAK)}, rounds)
    peak = 2 * PEAK**3 / float(np.median(seconds["sgemm"])) / 1e9
    rows: dict[str, Any] = {}
    for name, task in tasks.items():
        total, convolutions, work = float(np.median(seconds[name])), task.median("convolutions"), task.engine
        rows[name] = {
            **summary(seconds[name]),
            "steps": {step: 1e3 * task.median(step) for step in ("voxels", "maps", "transfers", "convolutions")},
            "GFLOP/s": 2 * work.multiply_adds / total / 1e9,
            "% of sgemm": 2 * work.multiply_adds / total / 1e7 / peak,
            "convolutions %": 2 * work.multiply_adds / convolutions / 1e7 / peak,
            "% not convolutions": 100 * (1 - convolutions / total),
            "buffers MB": work.workspace / 1e6,
        }
    rows["sgemm"] = {**summary(seconds["sgemm"]), "GFLOP/s": peak}
    steps = {name: rows[name]["steps"] for name in tasks}
    table = {name: {key: value for key, value in row.items() if key != "steps"} for name, row in rows.items()}
    show(f"whole scan of {len(scan.xyz)} points, {work.voxels} voxels, ms", brief(table))
    show("of that, ms", steps)
    return rows


def refinement(scan: Scan, candidates: np.ndarray, threads: int, rounds: int) -> dict[str, Any]:
    """Lite head: candidates against a full run; time, and what becomes of their labels."""
    engine, rows = make_head("lite", threads), {}
    kinds: dict[str, tuple[Any, ...]] = {
        "whole scan": (),
        "default halo": (candidates,),
        "exact halo": (candidates, "exact"),
        "no candidates": (np.zeros_like(candidates),),
    }
    tasks = {name: Refinement(engine, (*scan.args, *asked)) for name, asked in kinds.items()}
    seconds = interleaved(tasks, rounds)
    full, asked = tasks["whole scan"]()[candidates], 100 * candidates.mean()
    for name, task in tasks.items():
        found = task()[candidates]
        rows[name] = {
            **summary(seconds[name]),
            "% of whole": 100 * float(np.median(seconds[name]) / np.median(seconds["whole scan"])),
            "convolutions": 1e3 * task.median("convolutions"),
            "voxels": engine.voxels,
        }
        if name != "no candidates":
            rows[name]["% same label"] = 100 * float((found.argmax(1) == full.argmax(1)).mean())
            rows[name]["% of one label"] = 100 * float(np.bincount(found.argmax(1)).max() / len(found))
            rows[name]["difference"] = f"{np.abs(found - full).max():.1e}"
    show(f"refinement (lite) of {asked:.2f} % of {len(candidates)} points, ms", brief(rows))
    return {**rows, "% candidates": float(asked)}


def targets(results: dict[str, Any]) -> dict[str, Any]:
    """What was asked for beside what was measured, of the parts that ran."""
    found: dict[str, Any] = {}

    def most(what: str, measured: float, limit: float) -> None:
        found[what] = {"measured": measured, "asked for": f"<= {limit:g}", "met": bool(measured <= limit)}

    def least(what: str, measured: float, limit: float) -> None:
        found[what] = {"measured": measured, "asked for": f">= {limit:g}", "met": bool(measured >= limit)}

    if "heads" in results:
        lite, full = results["heads"]["lite"], results["heads"]["full"]
        most("lite, whole scan, ms", lite["median"], 900)
        most("full, whole scan, ms", full["median"], 2000)
        least("lite, all steps, % of sgemm", lite["% of sgemm"], 65)
        least("lite, convolutions alone, % of sgemm (aim)", lite["convolutions %"], 80)
        most("lite, % not convolutions", lite["% not convolutions"], 10)
    for layer, rows in results.get("layers", {}).items():
        for other in sparse_layer.OTHERS:
            if "median" in rows[other]:
                least(f"{layer}, times faster than {other}", rows[other]["median"] / rows["this"]["median"], 2)
            else:
                found[f"{layer}, times faster than {other}"] = {"asked for": ">= 2", "met": "not installed"}
    if "refinement" in results:
        rows = results["refinement"]
        most("refinement, candidates, % of the points", rows["% candidates"], 2)
        most("refinement, default halo, % of whole scan", rows["default halo"]["% of whole"], 12)
        least("refinement, default halo, % same label", rows["default halo"]["% same label"], 99.5)
        most("refinement, exact halo, difference", float(rows["exact halo"]["difference"]), 1e-5)
        found["refinement, exact halo, ms"] = {"measured": rows["exact halo"]["median"]}
    if "agreement" in results:
        least("refinement, default halo, trained weights, % same label", results["agreement"]["% same label"], 99.5)
    if "sizes" in results:
        smallest, _, base, *large = results["sizes"].values()
        work = smallest["G multiply-adds"] * base["ps per multiply-add"]  # ms, at the rate of 100,000 voxels
        most("1,000 voxels, ms", smallest["median"], 10)
        most("1,000 voxels, fixed cost (beyond its multiply-adds), ms", smallest["median"] - work, 10)
        for voxels, row in zip(list(results["sizes"])[3:], large, strict=True):
            times = row["ps per multiply-add"] / base["ps per multiply-add"]
            most(f"{voxels} voxels, time per multiply-add, times that at 100,000", times, 1.1)
    if "memory" in results:
        row = results["memory"]
        most(f"growth of memory from scan 50 to {row['scans']}, MB", row["growth"], 5)
    show("the point head against what it has to reach", found)
    return found


def measure(
    part: str, frames: list[Frame], labelled: Path | None, threads: int, rounds: int, scans: int, plot: Path | None
) -> dict[str, Any]:
    """The results of one of PARTS."""
    if part == "heads":
        return heads(Scan(frames[0][0]), threads, rounds)
    if part == "layers":
        return sparse_layer.layers(frames[0][0], threads, 2 * rounds)
    if part == "refinement":
        if labelled is None:
            scan = Scan(frames[0][0])
            return refinement(scan, scan.near(0), threads, rounds)
        return refinement(*busiest(labelled), threads, rounds)
    if part == "sizes":
        return sizes(frames, threads, max(3, rounds // 2), plot)
    return memory([Scan(points) for points, _ in frames], threads, scans)


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    labelled: Annotated[
        Path | None, typer.Option(help="A sequence with labels, whose movers are the candidates; else a cube of points")
    ] = None,
    threads: int = 2,
    rounds: int = 7,
    scans: Annotated[int, typer.Option(help="Scans of the memory test", min=1)] = 1000,
    skip: Annotated[list[str] | None, typer.Option(help=f"Parts to leave out: {', '.join(PARTS)}")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Parts to run, instead of all")] = None,
    bundle: Annotated[
        Path | None, typer.Option(help="A bundle with a trained point head: its labels near candidates and everywhere")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="SVG of cost against size")] = None,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """All tables of the point head. Medians of one run; random weights and features, real geometry."""
    if unknown := {*(skip or ()), *(only or ())} - set(PARTS):
        raise typer.BadParameter(f"{', '.join(sorted(unknown))}: the parts are {', '.join(PARTS)}")
    frames = load_frames(sequence, 11)
    results: dict[str, Any] = {}
    for part in PARTS:
        if part in (only or PARTS) and part not in (skip or ()):
            results[part] = measure(part, frames, labelled, threads, rounds, scans, plot)
    if bundle is not None:
        results["agreement"] = agreement(bundle, labelled or sequence, threads)
    save(out, threads, {"targets": targets(results), **results})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "point_head"))

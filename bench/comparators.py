"""The comparators, LiMoSeg and Cylinder3D, at their full width against what they have to reach.

python -m bench.comparators --sequence ../shared/data/kitti/sequences/00 --out comparators.json

Whole scans with a past one, with random weights: time does not follow content, but that of Cylinder3D follows where
points are. About two minutes on two cores.
"""

import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.head_scans import sgemm
from bench.latency import ROWS, SHOWN, alone, measure, random_bundle
from bench.point_head import PEAK
from bench.report import interleaved, save, show, summary
from bench.scans import load_frames
from runtime import MosRunner
from runtime.bundle.loading import load_bundle
from runtime.commands.handler import run_alone
from runtime.head.cylinder.cylinder_net import CylinderNet

CYLINDER3D, LIMOSEG = "Cylinder3D", ("LiMoSeg", "LiMoSeg in INT8")  # rows of `bench.latency`
NETWORK = ("maps", "points", "cells")  # what its time is spent on


def cylinder3d(bundle: Path, sequence: Path | None, threads: int, rounds: int) -> dict[str, Any]:
    """One scan after another, each with the one before as its past, beside the fastest matrix product between them."""
    runner = MosRunner(bundle, threads=threads, postprocess="none")
    network = runner._stages.network
    assert isinstance(network, CylinderNet)
    frames = iter(load_frames(sequence, rounds + 2))
    runner.remember(*next(frames))
    rows: list[dict[str, float]] = []

    def label_next() -> None:
        scan, pose = next(frames)
        result = runner(scan, pose)
        counted = {"scanned points": len(scan), "work": network.multiply_adds}
        rows.append({**counted, **result.timing, **network.timing})

    seconds = interleaved({"scan": label_next, "sgemm": sgemm(PEAK)}, rounds)
    of_each = {name: np.array([row[name] for row in rows[1:]]) for name in rows[0]}  # the first scan is a warm-up
    of_each["scan"], peak = np.array(seconds["scan"]), PEAK**3 / min(seconds["sgemm"])
    found = {
        "ms": {step: summary(list(of_each[step])) for step in ("input", "network", *NETWORK, "scan")},
        "points of a scan": int(np.median(of_each["scanned points"])),
        "G multiply-adds": round(float(np.median(of_each["work"])) / 1e9, 1),
        "sgemm, G multiply-adds/s": round(peak / 1e9, 1),
        "% of sgemm": {
            step: round(float(np.median(100 * of_each["work"] / of_each[step])) / peak, 1)
            for step in ("scan", "network", "cells")
        },
    }
    show(f"{CYLINDER3D}, ms a scan (median)", {CYLINDER3D: {step: row["median"] for step, row in found["ms"].items()}})
    return found


def limoseg(bundles: dict[str, Path], sequence: Path, threads: int, scans: int) -> dict[str, Any]:
    """Stage by stage, as in `bench.latency`."""
    found = {name: alone(measure, ROWS[name], path, sequence, threads, scans) for name, path in bundles.items()}
    show(
        "LiMoSeg, ms a scan (median)",
        {name: {stage: row["ms"][stage]["median"] for stage in SHOWN} for name, row in found.items()},
    )
    return found


def targets(results: dict[str, Any]) -> dict[str, Any]:
    """What was asked for beside what was measured."""
    share = results[CYLINDER3D]["% of sgemm"]["scan"]
    found = {f"{CYLINDER3D}, whole scan, % of sgemm": {"measured": share, "asked for": ">= 70", "met": share >= 70}}
    for name in LIMOSEG:
        ms = results[name]["ms"]["scan"]["median"]
        found[f"{name}, whole scan, ms"] = {"measured": ms, "asked for": "<= 60", "met": ms <= 60}
    for name, difference in results["difference from PyTorch"].items():
        met = difference <= 1e-4
        found[f"{name}, from PyTorch"] = {"measured": f"{difference:.0e}", "asked for": "<= 1e-4", "met": met}
    show("the comparators against what they have to reach", found)
    return found


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    threads: int = 2,
    rounds: Annotated[int, typer.Option(help="Scans of Cylinder3D")] = 9,
    scans: Annotated[int, typer.Option(help="Scans of LiMoSeg")] = 50,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Time, multiply-adds and agreement with PyTorch of the comparators. Medians of one run."""
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        if sequence is None:
            from mos_model.simulator.write import write_dataset

            sequence = write_dataset(work / "street", 1, 40, 7).path / "sequences" / "00"
        bundles = {}
        for name in (*LIMOSEG, CYLINDER3D):
            (work / name).mkdir()
            bundles[name] = alone(random_bundle, ROWS[name].config, ROWS[name].precision, work / name)
        floats = [name for name in bundles if ROWS[name].precision == "float32"]
        parity = {name: load_bundle(bundles[name]).manifest.parity["image_net"] for name in floats}
        whole = alone(cylinder3d, bundles.pop(CYLINDER3D), sequence, threads, rounds)
        results = {CYLINDER3D: whole, **limoseg(bundles, sequence, threads, scans), "difference from PyTorch": parity}
    save(out, threads, {"targets": targets(results), **results})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "comparators"))

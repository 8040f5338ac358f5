"""Trained weights in use: what a bundle's point head says near possible movers, and when it looks at all points."""

from pathlib import Path
from typing import Any

import numpy as np

from bench.report import show
from bench.scans import load_frames
from runtime import MosRunner
from runtime.bundle.residual import HISTORY

SCANS = 20


def agreement(bundle: Path, sequence: Path | None, threads: int) -> dict[str, Any]:
    """Labels and time of `refine="near"` (default halo) beside `refine="all"`, over all candidates of some scans."""
    runners = {
        "pixels": MosRunner(bundle, threads=threads, postprocess="none"),
        "near": MosRunner(bundle, threads=threads, postprocess="head", refine="near"),
        "all": MosRunner(bundle, threads=threads, postprocess="head", refine="all"),
    }
    asked = same = points = 0
    seconds: dict[str, list[float]] = {name: [] for name in runners}
    for scan, pose in load_frames(sequence, HISTORY + SCANS):
        found = {name: runner(scan, pose) for name, runner in runners.items()}
        if not found["all"].ready:
            continue
        candidates = found["pixels"].probability > runners["near"].bundle.manifest.tuned.candidate
        points, asked = points + len(scan), asked + int(candidates.sum())
        same += int((found["near"].moving == found["all"].moving)[candidates].sum())
        for name, result in found.items():
            seconds[name].append(result.timing["postprocess"])
    row = {
        "scans": len(seconds["all"]),
        "% candidates": 100 * asked / max(1, points),
        "% same label": 100 * same / max(1, asked),
        "near, ms": 1e3 * float(np.median(seconds["near"])),
        "all, ms": 1e3 * float(np.median(seconds["all"])),
    }
    show("refinement near possible movers beside all points, trained weights", {str(bundle): row})
    return row

"""Point heads and scans for the benchmarks of the point head: published layouts with random weights and features."""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import ROOT
from export.bundle.head_weights import fold
from export.checkpoint.key_map import head_modules, under_our_names
from runtime.bundle.head_shape import FULL, LITE
from runtime.bundle.residual import Residual
from runtime.classes import MOVING, to_classes
from runtime.compute.workers import Workers
from runtime.head.numba_engine import FeatureMap, PointHeadEngine
from runtime.image.inputs import InputBuilder
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from runtime.sensors.range_image import RangeImage

HEADS = {"lite": LITE, "full": FULL}
SEED = 2026  # of weights and features


def make_head(name: str, threads: int) -> PointHeadEngine:
    """A published head with the reference weights."""
    path = ROOT / "tests" / "data" / "published" / "reference_weights.py"
    spec = importlib.util.spec_from_file_location("reference_weights", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    weights = under_our_names(module.reference_state_dict(f"point_head_{name}", SEED), head_modules(HEADS[name]))
    return PointHeadEngine(fold(weights, HEADS[name]), HEADS[name], Workers(threads))


class Scan:
    """Arguments of `refine` for a scan (N, 4), with random image features."""

    def __init__(self, points: np.ndarray) -> None:
        sensor, random = RangeImage(), np.random.default_rng(SEED)
        builder = InputBuilder(sensor, Residual(), Workers(1))
        entered = builder.enter(points)
        image = builder.build(entered, [])
        features = random.normal(size=(32, sensor.height, sensor.width)).astype(np.float32)
        self.xyz, self.valid = np.ascontiguousarray(points[:, :3]), entered.takes_part
        self.args = self.xyz, self.valid, FeatureMap(features, image.pixel, sensor.width)

    def near(self, seed: int, radius: float = 2.0) -> np.ndarray:
        """Candidates (N,): all points around one of the scan."""
        centre = self.xyz[np.random.default_rng(seed).choice(np.flatnonzero(self.valid))]
        return self.valid & (np.abs(self.xyz - centre) < radius).all(axis=1)


@dataclass
class Refinement:
    """A call of `refine` to be timed, that notes how long its steps took."""

    engine: PointHeadEngine
    args: tuple[Any, ...]
    steps: list[dict[str, float]] = field(default_factory=list)

    def __call__(self) -> np.ndarray:
        result = self.engine.refine(*self.args)
        self.steps.append(self.engine.timing)
        return result

    def median(self, step: str) -> float:
        """Seconds of a step; the first run, a warm-up, does not count."""
        return float(np.median([steps[step] for steps in self.steps[1:]]))


def busiest(sequence: Path) -> tuple[Scan, np.ndarray]:
    """The scan of a sequence with the most moving points, at most 2 % of it, and which they are."""
    recording = open_recording(sequence, Options(points_only=True))
    best, most = None, 0
    for index in range(len(recording)):
        if (labels := recording.labels(index)) is None:
            continue
        moving = to_classes(labels) == MOVING
        if most < moving.sum() <= 0.02 * len(moving):
            best, most = (index, moving), int(moving.sum())
    if best is None:
        raise ValueError(f"no scan of {sequence} has labels with at most 2 % of moving points")
    index, moving = best
    scan = Scan(recording.read(index).data)
    return scan, moving & scan.valid


def sgemm(size: int = 2048) -> Callable[[], object]:
    """A single-precision matrix product, with as many threads as NumPy's BLAS takes."""
    a, b, c = (np.ones((size, size), np.float32) for _ in range(3))
    return lambda: np.matmul(a, b, out=c)

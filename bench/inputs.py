"""Time of the network input (projection and 8 residual images) beside NumPy's: `python -m bench.inputs`."""

import math
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bench.report import interleaved, save, show, summary
from bench.scans import load_frames, taking_part
from runtime.bundle.residual import HISTORY, Residual
from runtime.commands.handler import run_alone
from runtime.compute.workers import Workers
from runtime.image.history import Past
from runtime.image.inputs import InputBuilder
from runtime.recordings.poses import relative_pose
from runtime.sensors.range_image import RangeImage


def numpy_range_image(points: np.ndarray, sensor: RangeImage, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Range image and nearest points with whole-array operations: the farthest point is written first."""
    r = np.linalg.norm(points[:, :3], axis=1)
    index = np.flatnonzero((r > low) & (r < high))
    x, y, z, r = (*points[index, :3].T, r[index])
    up, down = math.radians(sensor.fov_up), math.radians(-sensor.fov_down)
    u = np.floor(0.5 * (1 - np.arctan2(y, x) / np.pi) * sensor.width).clip(0, sensor.width - 1).astype(np.int32)
    v = (1 - (np.arcsin(z / r) + down) / (up + down)) * sensor.height
    v = np.floor(v).clip(0, sensor.height - 1).astype(np.int32)
    order = np.argsort(-r)
    image, first = np.zeros((sensor.height, sensor.width), np.float32), np.full((sensor.height, sensor.width), -1)
    image[v[order], u[order]] = r[order]
    first[v[order], u[order]] = index[order]
    return image, first


def numpy_input(points: np.ndarray, past: list[Past], sensor: RangeImage, residual: Residual) -> np.ndarray:
    """The whole input (13, H, W)."""
    nearest, first = numpy_range_image(points, sensor, 0.0, np.inf)
    channels = np.concatenate([nearest[None], np.moveaxis(points[first], 2, 0)])
    mean, std = (np.array(values, np.float32)[:, None, None] for values in (sensor.mean, sensor.std))
    image = np.zeros((5 + len(past), sensor.height, sensor.width), np.float32)
    image[:5] = np.where(first >= 0, (channels - mean) / std, 0)
    limits = residual.min_range, residual.max_range
    current, _ = numpy_range_image(points, sensor, *limits)
    for i, one in enumerate(past):
        transform = one.relative.astype(np.float32)
        moved = one.points[:, :3] @ transform[:3, :3].T + transform[:3, 3]
        before, _ = numpy_range_image(moved, sensor, *limits)
        both = (current > 0) & (before > 0)
        image[5 + i][both] = np.abs(before[both] - current[both]) / current[both]
    return image


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    threads: int = 2,
    rounds: int = 60,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Median time of the 13-channel input of one scan with 8 past scans."""
    frames = load_frames(sequence, HISTORY + 1)
    (points, pose), before = frames[-1], frames[-2::-1]
    points = taking_part(points)
    past = [Past(np.ascontiguousarray(taking_part(scan)[:, :3]), relative_pose(pose, p)) for scan, p in before]
    sensor, residual = RangeImage(), Residual()
    builders = {n: InputBuilder(sensor, residual, Workers(n)) for n in sorted({1, threads})}
    image = builders[threads].build(builders[threads].enter(points), past).image
    differs = (np.abs(image - numpy_input(points, past, sensor, residual)) > 1e-3).any(0).mean()
    tasks = {f"{n} threads": (lambda b=b: b.build(b.enter(points), past)) for n, b in builders.items()}
    seconds = interleaved(tasks, rounds)
    plain = {"NumPy": lambda: numpy_input(points, past, sensor, residual)}
    seconds |= interleaved(plain, max(3, rounds // 10))
    rows = {name: summary(values) for name, values in seconds.items()}
    show(f"input of {len(points)} points and {len(past)} past scans, ms; {differs:.1e} of the pixels differ", rows)
    save(out, threads, {"points": len(points), "pixels_differing_from_numpy": float(differs), "ms": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "inputs"))

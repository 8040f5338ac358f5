"""Naive projection and residual images: network.md's formulas in float64, point by point."""

import math

import numpy as np

from runtime.bundle.residual import Residual
from runtime.sensors.range_image import RangeImage


def project_point(x: float, y: float, z: float, sensor: RangeImage) -> tuple[int, int, float]:
    """Column, row and range of a point; (-1, -1, 0) where it has none."""
    r = math.sqrt(x * x + y * y + z * z) if all(map(math.isfinite, (x, y, z))) else 0.0
    if r == 0:
        return -1, -1, 0.0
    up, down = math.radians(sensor.fov_up), math.radians(sensor.fov_down)
    elevation = math.asin(max(-1.0, min(1.0, z / r)))
    u = math.floor(0.5 * (1 - math.atan2(y, x) / math.pi) * sensor.width)
    v = math.floor((1 - (elevation - down) / (up - down)) * sensor.height)
    if sensor.elevations:
        v = min(range(len(sensor.elevations)), key=lambda i: abs(math.degrees(elevation) - sensor.elevations[i]))
    return min(max(u, 0), sensor.width - 1), min(max(v, 0), sensor.height - 1), r


def range_image(points: np.ndarray, sensor: RangeImage, low: float = 0.0, high: float = math.inf) -> np.ndarray:
    """(H, W) range of the nearest point with low < r < high; 0 where there is none."""
    image = np.zeros((sensor.height, sensor.width))
    for x, y, z in points[:, :3].astype(np.float64):
        u, v, r = project_point(x, y, z, sensor)
        if u >= 0 and low < r < high and (image[v, u] == 0 or r < image[v, u]):
            image[v, u] = r
    return image


def input_image(points, past, relative, sensor: RangeImage, residual: Residual) -> np.ndarray:
    """(5 + lags, H, W): see `runtime.image.inputs.InputBuilder.build`."""
    image = np.zeros((5 + len(residual.lags), sensor.height, sensor.width))
    nearest = np.full(image.shape[1:], math.inf)
    for x, y, z, remission in points.astype(np.float64):
        u, v, r = project_point(x, y, z, sensor)
        if u >= 0 and r < nearest[v, u]:
            nearest[v, u] = r
            image[:5, v, u] = (np.array((r, x, y, z, remission)) - sensor.mean) / sensor.std
    limits = residual.min_range, residual.max_range
    current = range_image(points, sensor, *limits)
    for channel, lag in enumerate(residual.lags, start=5):
        if lag > len(past) or past[lag - 1] is None:
            continue
        scan = past[lag - 1][:, :3].astype(np.float64)
        moved = scan @ relative[lag - 1][:3, :3].T + relative[lag - 1][:3, 3]
        before = range_image(moved, sensor, *limits)
        both = (current > 0) & (before > 0)
        change = (before[both] - current[both]) / current[both]
        image[channel][both] = change if residual.kind == "signed" else np.abs(change)
    return image

"""Naive upright points and misfit, point by point."""

import math

import numpy as np

from runtime.doctor.landmarks import ABOVE, APIECE, CELL, FAR, NEAR, REACH, UPRIGHT


def upright(points: np.ndarray) -> np.ndarray:
    """All points of cells that span a height, but for the lowest of each and those beyond APIECE of it."""
    cells: dict[tuple[int, int], list[np.ndarray]] = {}
    near = [point for point in points if NEAR < math.hypot(point[0], point[1]) < FAR]
    for x, y, z in near:
        cells.setdefault((math.floor((x + FAR) / CELL), math.floor((y + FAR) / CELL)), []).append(np.array([x, y, z]))
    found = []
    taken = dict.fromkeys(cells, 0)
    for x, y, z in near:
        cell = math.floor((x + FAR) / CELL), math.floor((y + FAR) / CELL)
        heights = [point[2] for point in cells[cell]]
        tall = max(heights) - min(heights) > UPRIGHT and z > min(heights) + ABOVE
        if tall and taken[cell] < APIECE:
            taken[cell] += 1
            found.append((x, y, z))
    return np.array(found, np.float32).reshape(-1, 3)


def misfit(landmarks: np.ndarray, motion: np.ndarray, nearest: np.ndarray, fov_down: float, fov_up: float) -> float:
    """Mean distance along the ray to the nearest surface of the 3 x 3 pixels around; NaN where there is none."""
    height, width = nearest.shape
    distances = []
    for point in landmarks:
        x, y, z = motion[:3, :3] @ point + motion[:3, 3]
        distance = math.sqrt(x * x + y * y + z * z)
        elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
        row = math.floor((1 - (elevation - fov_down) / (fov_up - fov_down)) * height)
        column = math.floor(0.5 * width * (1 - math.atan2(y, x) / math.pi))
        if not 1 <= row < height - 1:
            continue
        around = [nearest[row + v, (column + u) % width] for v in (-1, 0, 1) for u in (-1, 0, 1)]
        seen = [value for value in around if 0 < value < math.inf]
        if any(value >= distance - REACH for value in seen):
            distances.append(min([REACH, *(abs(value - distance) for value in seen)]))
    return float(np.mean(distances)) if distances else math.nan

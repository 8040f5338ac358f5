"""Naive bird's-eye view, as `runtime.image.bird_inputs` describes it: point by point in float64."""

import math

import numpy as np

from runtime.bundle.view import BirdView


def cell_of(point, bird: BirdView) -> tuple[int, int] | None:
    """Row and column of a point (x, y, z) m, or None out of the view."""
    x, y, z = map(float, point[:3])
    if not all(map(math.isfinite, (x, y, z))) or not bird.bottom <= z < bird.top:
        return None
    half = 0.5 * bird.cells * bird.cell_size
    v, u = math.floor((half - x) / bird.cell_size), math.floor((half - y) / bird.cell_size)
    return (v, u) if 0 <= v < bird.cells and 0 <= u < bird.cells else None


def scan_channels(points, bird: BirdView) -> np.ndarray:
    """(5, cells, cells): highest and lowest z from the middle of the view, density, whether there is a point, and the
    index of the highest point (the first in scan order, -1: none)."""
    found: dict[tuple[int, int], list[int]] = {}
    for i, point in enumerate(points):
        if (cell := cell_of(point, bird)) is not None:
            found.setdefault(cell, []).append(i)
    channels = np.zeros((5, bird.cells, bird.cells))
    channels[4] = -1
    for cell, members in found.items():
        heights = [float(points[i][2]) for i in members]
        middle = (bird.top + bird.bottom) / 2
        density = min(1.0, math.log(1 + len(members)) / math.log(64))
        highest = members[heights.index(max(heights))]
        channels[(slice(None), *cell)] = max(heights) - middle, min(heights) - middle, density, 1, highest
    return channels


def input_image(points, past, relative, bird: BirdView, lags, mean: float, std: float) -> np.ndarray:
    """(5 + 4 lags, cells, cells): see `runtime.image.bird_inputs.BirdInputBuilder.build`."""
    current = scan_channels(points, bird)
    image = np.zeros((5 + 4 * len(lags), bird.cells, bird.cells))
    image[:4] = current[:4]
    for v, u in zip(*np.nonzero(current[4] >= 0), strict=True):
        image[4, v, u] = (min(max(float(points[int(current[4, v, u])][3]), 0.0), 1.0) - mean) / std
    for k, lag in enumerate(lags):
        if lag <= len(past) and past[lag - 1] is not None:
            scan = past[lag - 1][:, :3].astype(np.float64)
            moved = scan @ relative[lag - 1][:3, :3].T + relative[lag - 1][:3, 3]
            image[5 + 4 * k : 9 + 4 * k] = scan_channels(moved, bird)[:4]
    return image

"""Naive cells of a cylinder, as `runtime.image.cylinder_inputs` and `runtime.head.cylinder` say: one at a time."""

import math
from itertools import product

import numpy as np

from runtime.bundle.view import CylinderView
from runtime.head.cylinder.cells import STRIDES


def place_of(point, view: CylinderView) -> tuple[int, int, int] | None:
    """Ring, sector and layer of a point (x, y, z) m, or None out of the cylinder."""
    x, y, z = map(float, point[:3])
    if not all(map(math.isfinite, (x, y, z))):
        return None
    ring = math.floor(math.hypot(x, y) / view.radius * view.rings)
    sector = min(math.floor((math.atan2(y, x) / math.pi + 1) / 2 * view.sectors), view.sectors - 1)
    layer = math.floor((z - view.bottom) / (view.top - view.bottom) * view.layers)
    return (ring, sector, layer) if ring < view.rings and 0 <= layer < view.layers else None


def channels_of(point, remission: float, time: float, view: CylinderView) -> np.ndarray:
    """(11,) what the network is shown of a point; `remission` is normalised."""
    place = place_of(point, view)
    if place is None:
        return np.array([0.0] * 10 + [-1.0])
    x, y, z = map(float, point[:3])
    distance, angle = math.hypot(x, y), math.atan2(y, x)
    steps = view.radius / view.rings, 2 * math.pi / view.sectors, (view.top - view.bottom) / view.layers
    starts = 0.0, -math.pi, view.bottom
    middle = [start + (n + 0.5) * step for start, n, step in zip(starts, place, steps, strict=True)]
    of_cell = [value - at for value, at in zip((distance, angle, z), middle, strict=True)]
    number = (place[0] * view.sectors + place[1]) * view.layers + place[2]
    return np.array([*of_cell, distance, angle, z, x, y, remission, time, number])


def scales(cells: set[tuple[int, int, int]], size: tuple[int, int, int]) -> list[tuple[list, tuple[int, int, int]]]:
    """Cells, sorted, and size of every scale: a cell is there where one of the 27 below it is."""
    found = [(sorted(cells), size)]
    for stride in STRIDES:
        size = tuple(math.ceil(n / s) for n, s in zip(size, stride, strict=True))
        below = set(found[-1][0])
        every = product(*(range(n) for n in size))
        found.append(([cell for cell in every if below & set(around(cell, stride))], size))
    return found


def around(cell: tuple[int, int, int], stride=(1, 1, 1)) -> list[tuple[int, ...]]:
    """The 27 cells that a cell of the next scale meets, layers fastest."""
    offsets = product((-1, 0, 1), repeat=3)
    return [tuple(c * s + o for c, s, o in zip(cell, stride, offset, strict=True)) for offset in offsets]


def table(out: list, inputs: list, stride, up: bool) -> np.ndarray:
    """(V, 27) row of the input at each offset, len(inputs): none."""
    rows = {cell: row for row, cell in enumerate(inputs)}
    if not up:
        return np.array([[rows.get(cell, len(inputs)) for cell in around(one, stride)] for one in out])
    found = np.full((len(out), 27), len(inputs))
    at = {cell: row for row, cell in enumerate(out)}
    for coarse in inputs:
        for k, cell in enumerate(around(coarse, stride)):
            if cell in at:
                found[at[cell], k] = rows[coarse]
    return found

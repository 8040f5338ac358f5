"""Which cells of a cylinder meet: tables of neighbours at five scales, each from a grid of row numbers.

Scales halve rings and sectors four times, layers twice. A cell of the next scale is there where any of the 27 cells
below it is: a convolution 3x3x3 with stride 2 and padding 1, as Cylinder3D has it. The 27 offsets go from -1 to 1 on
each axis, layers fastest, then sectors, then rings.
"""

from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

from runtime.compute.arena import Arena
from runtime.compute.arguments import need, need_below
from runtime.compute.jit import inlined, kernel
from runtime.compute.workers import Workers
from runtime.head.sparse.kernel_map import KernelMap, table_map

STRIDES = ((2, 2, 2), (2, 2, 2), (2, 2, 1), (2, 2, 1))  # from each scale to the next: rings, sectors, layers
# Columns of a table that a smaller kernel takes; the sizes are rings x sectors x layers.
_OFFSETS = np.stack(np.meshgrid(*3 * [(-1, 0, 1)], indexing="ij"), -1).reshape(27, 3)
KERNELS = {
    "3x3x3": np.arange(27),
    "1x3x3": np.flatnonzero(_OFFSETS[:, 0] == 0),
    "3x1x3": np.flatnonzero(_OFFSETS[:, 1] == 0),
    "3x1x1": np.flatnonzero(np.abs(_OFFSETS[:, 1:]).sum(axis=1) == 0),
    "1x3x1": np.flatnonzero(np.abs(_OFFSETS[:, ::2]).sum(axis=1) == 0),
    "1x1x3": np.flatnonzero(np.abs(_OFFSETS[:, :2]).sum(axis=1) == 0),
}
_GRAIN = 8192  # cells per task
_NONE = np.int32(-1)

Cells = tuple[int, int, int]


@dataclass(frozen=True)
class CellScale:
    """The occupied cells of one scale. Raises ScanError where they do not fit."""

    size: Cells  # cells on each axis
    cells: NDArray[np.int32]  # (V,) numbers, rising
    rows: NDArray[np.int32]  # (size,) row of each cell, -1: none

    def __post_init__(self) -> None:
        need(self.cells, "cells", (None,), np.int32)
        need(self.rows, "rows", (prod(self.size),), np.int32)
        need_below(self.cells, len(self.rows), "cells", lowest=0)


def occupied(numbers: NDArray[np.int32], size: Cells, arena: Arena) -> CellScale:
    """The scale of the points' cells: numbers (M,), -1: in none."""
    rows = arena.take("rows0", (size[0] * size[1] * size[2],), np.int32)
    rows[:] = _NONE
    _mark(numbers, rows)
    return CellScale(size, _number(rows), rows)


def coarser(fine: CellScale, level: int, arena: Arena) -> CellScale:
    """The next scale, which is number `level`."""
    stride = STRIDES[level - 1]
    size = tuple(-(-n // s) for n, s in zip(fine.size, stride, strict=True))
    rows = arena.take(f"rows{level}", (size[0] * size[1] * size[2],), np.int32)
    rows[:] = _NONE
    _mark_above(fine.cells, fine.size, stride, size, rows)
    return CellScale(size, _number(rows), rows)  # type: ignore[arg-type]


def meeting(
    out: CellScale, inputs: CellScale, stride: Cells, up: bool, arena: Arena, workers: Workers, name: str
) -> NDArray[np.int32]:
    """Table (V + 1, 27) of the row of `inputs` at each offset of each cell of `out`, len(inputs.cells): none.

    Down (or within a scale, by a stride of 1) that is the cell `stride * o + offset`; up, the cell i for which
    `stride * i + offset` is o. The last row is not used.
    """
    table = arena.take(name, (len(out.cells) + 1, 27), np.int32)
    find = _above if up else _below
    given = out.cells, out.size, inputs.rows, inputs.size, stride, len(inputs.cells)
    workers.ranges(lambda a, b: find(*given, a, b, table), len(out.cells), _GRAIN)
    table[-1] = len(inputs.cells)
    return table


def kernel_map(
    table: NDArray[np.int32], kernel: str, count_in: int, arena: Arena, workers: Workers, name: str
) -> KernelMap:
    """The kernel map of one of KERNELS from a table of 27 offsets."""
    columns = KERNELS[kernel]
    if len(columns) < 27:
        whole, table = table, arena.take(f"{name}.table", (len(table), len(columns)), np.int32)
        np.take(whole, columns, axis=1, out=table)
    return table_map(table, count_in, arena, workers, name)


@inlined
def _place(cell, size):  # type: ignore[no-untyped-def]
    """Ring, sector and layer of a cell by its number."""
    rest, w = divmod(cell, size[2])
    u, v = divmod(rest, size[1])
    return u, v, w


@inlined
def _number_of(x, y, z, size):  # type: ignore[no-untyped-def]
    """The number of the cell at a place, -1: there is none."""
    inside = 0 <= x < size[0] and 0 <= y < size[1] and 0 <= z < size[2]
    return (x * size[1] + y) * size[2] + z if inside else -1


@inlined
def _above_number(a, b, c, stride, size):  # type: ignore[no-untyped-def]
    """The number of the cell o of the next scale for which stride * o is (a, b, c), -1: there is none."""
    x, y, z = a // stride[0], b // stride[1], c // stride[2]
    whole = x * stride[0] == a and y * stride[1] == b and z * stride[2] == c
    return _number_of(x, y, z, size) if whole else -1


@inlined
def _row(number, rows, none):  # type: ignore[no-untyped-def]
    """The row of an occupied cell, `none` of others."""
    row = rows[number] if number >= 0 else -1
    return row if row >= 0 else none


@kernel
def _mark(numbers, rows):  # type: ignore[no-untyped-def]
    for i in range(numbers.size):
        if 0 <= numbers[i] < rows.size:
            rows[numbers[i]] = 0


@kernel
def _number(rows):  # type: ignore[no-untyped-def]
    """Numbers the cells that are marked; returns them."""
    count = 0
    for cell in range(rows.size):
        if rows[cell] >= 0:
            rows[cell] = count
            count += 1
    cells = np.empty(count, np.int32)
    for cell in range(rows.size):
        if rows[cell] >= 0:
            cells[rows[cell]] = cell
    return cells


@kernel
def _mark_above(cells, size, stride, above, rows):  # type: ignore[no-untyped-def]
    """Marks the cells o of the next scale for which stride * o + offset is one of `cells`."""
    for i in range(cells.size):
        u, v, w = _place(cells[i], size)
        for a in range(max(u - 1, 0), u + 2):
            for b in range(max(v - 1, 0), v + 2):
                for c in range(max(w - 1, 0), w + 2):
                    number = _above_number(a, b, c, stride, above)
                    if number >= 0:
                        rows[number] = 0


@kernel
def _below(cells, size, rows, size_in, stride, none, start, stop, table):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        u, v, w = _place(cells[i], size)
        k = 0
        for a in range(u * stride[0] - 1, u * stride[0] + 2):
            for b in range(v * stride[1] - 1, v * stride[1] + 2):
                for c in range(w * stride[2] - 1, w * stride[2] + 2):
                    table[i, k] = _row(_number_of(a, b, c, size_in), rows, none)
                    k += 1


@kernel
def _above(cells, size, rows, size_in, stride, none, start, stop, table):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        u, v, w = _place(cells[i], size)
        k = 0
        for a in range(u + 1, u - 2, -1):
            for b in range(v + 1, v - 2, -1):
                for c in range(w + 1, w - 2, -1):
                    table[i, k] = _row(_above_number(a, b, c, stride, size_in), rows, none)
                    k += 1

"""Points to voxels: one row per occupied voxel, in Morton order, so that near voxels lie near in memory."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.compute.jit import inlined, kernel
from runtime.compute.workers import Workers
from runtime.errors import ScanError

AXIS_BITS = 21  # three axes fill 63 bits of a key
_GRAIN = 32_768  # points per task
_FAR = 1 << 30  # voxels; farther points cannot be counted in 32 bits
BLOCK = 2  # blocks of 2^2 voxels a side are near candidates, or not, as a whole
_SIDE, _HEIGHT = 256, 32  # blocks in x and y, and in z, after which marks repeat; powers of 2


@dataclass(frozen=True)
class Voxels:
    """The occupied voxels of a scan. V voxels, N points, M of them in a voxel."""

    keys: NDArray[np.int64]  # (V,) Morton keys, rising; x in bit 2 of each triple, y in bit 1, z in bit 0
    order: NDArray[np.int32]  # (M,) points sorted by voxel, in scan order within one
    starts: NDArray[np.int32]  # (V + 1,) points of voxel v: order[starts[v] : starts[v + 1]]
    count: int  # N

    @property
    def coords(self) -> NDArray[np.int32]:
        """(V, 3) x y z in voxels, from 0 on each axis (see `voxelise`); computed at each call."""
        return _coordinates(self.keys)  # type: ignore[no-any-return]

    @property
    def first(self) -> NDArray[np.int32]:
        """(V,) the first point of the voxel in scan order; computed at each call."""
        return self.order[self.starts[:-1]]

    @property
    def inverse(self) -> NDArray[np.int32]:
        """(N,) the voxel of each point, -1 for points that were left out; computed at each call."""
        inverse = np.full(self.count, -1, np.int32)
        inverse[self.order] = np.repeat(np.arange(len(self.keys), dtype=np.int32), np.diff(self.starts))
        return inverse


def voxelise(
    xyz: NDArray[np.float32],
    voxel_size: float,
    workers: Workers,
    valid: NDArray[np.bool_] | None = None,
    near: tuple[NDArray[np.bool_], int] | None = None,
    step: int = 1,
) -> Voxels:
    """Voxels of a scan: `q = round(xyz / voxel_size)` in float32, ties to even, minus the minimum per axis.

    step: that minimum, down to a multiple of so many voxels: then grids of strides that divide it stand still in the
    sensor's frame, and no return, however low it lies, shifts those of the others.
    `xyz` (N, 3) float32 m; `valid` (N,) bool: those that take part, which are finite; None: all. `near`: candidates
    (N,) bool and a distance in voxels; leaves out the voxels that are farther (on some axis) from those of all
    candidates, but not each of them, on the grid of the whole scan. Raises ScanError where the scan spans 2^21 voxels.
    """
    xyz = np.require(xyz, np.float32, ["W"])  # columns of a wider array are read where they are
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ScanError(f"a scan's coordinates must be (N, 3), not {xyz.shape}")
    mask = np.ones(len(xyz), np.bool_) if valid is None else np.require(valid, np.bool_, ["C", "W"])
    if mask.shape != xyz.shape[:1]:
        raise ScanError(f"the mask of valid points must be ({len(xyz)},), not {mask.shape}")
    if near is not None and (np.shape(near[0]) != xyz.shape[:1] or near[1] < 0):
        raise ScanError(f"near must be a mask ({len(xyz)},) and a distance, not {np.shape(near[0])} and {near[1]}")
    count, size = len(xyz), np.float32(voxel_size)
    tasks = -(-count // _GRAIN)
    box = np.empty((tasks, 2, 3), np.float32)  # lowest and highest coordinates of each task
    workers.ranges(lambda start, stop: _extent(xyz, mask, start, stop, box[start // _GRAIN]), count, _GRAIN)
    lowest, span = _grid(box, size, step)
    marks = np.zeros((0, 0), np.uint32)
    if near is not None:
        marks = np.zeros((_SIDE, _SIDE), np.uint32)
        reach = min(near[1], _SIDE // 2 << BLOCK)
        _mark(xyz, size, lowest, mask, np.flatnonzero(np.require(near[0], np.bool_)), reach, marks)
    keys, points = np.empty(count, np.int64), np.empty(count, np.int32)
    ends = np.zeros(tasks, np.int64)

    def take(start: int, stop: int) -> None:
        ends[start // _GRAIN] = _keys(xyz, size, mask, marks, lowest, start, stop, keys, points)

    workers.ranges(take, count, _GRAIN)
    if tasks:
        keys, points = (
            np.concatenate([values[task * _GRAIN : end] for task, end in enumerate(ends)]) for values in (keys, points)
        )
    keys, order = _sort(keys, points, 3 * span.bit_length())
    keys, starts = _group(keys)
    return Voxels(keys, order, starts, count)


def _grid(box: NDArray[np.float32], size: np.float32, step: int) -> tuple[NDArray[np.int64], int]:
    """The voxel that is 0 on each axis, and the longest side in voxels; `box` (tasks, 2, 3) m, infinite without points.

    It is the lowest, or the next multiple of `step` below.
    """
    corners = np.stack([box[:, 0].min(axis=0, initial=np.inf), box[:, 1].max(axis=0, initial=-np.inf)])
    if not np.isfinite(corners).all():
        return np.zeros(3, np.int64), 0
    with np.errstate(over="ignore"):
        cells = np.rint(corners / size)  # rounding keeps order, so these are the first and last of the points' voxels
    farthest = float(np.abs(cells).max())
    lowest = cells[0].astype(np.float64) // step * step
    span = int(min((cells[1] - lowest).max(), 1 << AXIS_BITS))
    if farthest >= _FAR or span >> AXIS_BITS:
        raise ScanError(
            f"the scan spans {np.abs(corners).max():.3g} m or more, too far for {1 << AXIS_BITS} voxels of {size:g} m: "
            f"drop the far points or use larger voxels"
        )
    return lowest.astype(np.int64), span


@inlined
def _cell(x, size):  # type: ignore[no-untyped-def]
    return np.int64(np.rint(x / size))


@kernel
def _extent(xyz, valid, start, stop, box):  # type: ignore[no-untyped-def]
    x0 = y0 = z0 = np.float32(np.inf)
    x1 = y1 = z1 = np.float32(-np.inf)
    for i in range(start, stop):
        if valid[i]:
            x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
            x0, y0, z0 = min(x0, x), min(y0, y), min(z0, z)
            x1, y1, z1 = max(x1, x), max(y1, y), max(z1, z)
    box[0, 0], box[0, 1], box[0, 2] = x0, y0, z0
    box[1, 0], box[1, 1], box[1, 2] = x1, y1, z1


@kernel
def _mark(xyz, size, lowest, valid, candidates, reach, marks):  # type: ignore[no-untyped-def]
    """Set the bits (of z) of all blocks with a place for a voxel that is at most `reach` voxels from a candidate's."""
    low, high = np.ones(3, np.int64), np.zeros(3, np.int64)  # blocks around the candidate before
    for i in candidates:
        if not valid[i]:
            continue
        same = True
        for axis in range(3):
            voxel = _cell(xyz[i, axis], size) - lowest[axis]
            first, last = voxel - reach >> BLOCK, voxel + reach >> BLOCK
            same &= (first == low[axis]) & (last == high[axis])
            low[axis], high[axis] = first, last
        if same:
            continue
        tower = np.uint64((1 << min(high[2] - low[2] + 1, _HEIGHT)) - 1) << np.uint64(low[2] & _HEIGHT - 1)
        around = np.uint32((tower | tower >> np.uint64(_HEIGHT)) & np.uint64(0xFFFFFFFF))
        for u in range(low[0], high[0] + 1):
            for v in range(low[1], high[1] + 1):
                marks[u & _SIDE - 1, v & _SIDE - 1] |= around


@inlined
def _spread(x):  # type: ignore[no-untyped-def]
    """Two zero bits between neighbouring bits of a 21-bit number."""
    x = (x | x << 32) & 0x1F00000000FFFF
    x = (x | x << 16) & 0x1F0000FF0000FF
    x = (x | x << 8) & 0x100F00F00F00F00F
    x = (x | x << 4) & 0x10C30C30C30C30C3
    return (x | x << 2) & 0x1249249249249249


@inlined
def _gather_bits(x):  # type: ignore[no-untyped-def]
    """The inverse of `_spread`."""
    x = x & 0x1249249249249249
    x = (x | x >> 2) & 0x10C30C30C30C30C3
    x = (x | x >> 4) & 0x100F00F00F00F00F
    x = (x | x >> 8) & 0x1F0000FF0000FF
    x = (x | x >> 16) & 0x1F00000000FFFF
    return (x | x >> 32) & 0x1FFFFF


@kernel
def _keys(xyz, size, valid, marks, lowest, start, stop, keys, points):  # type: ignore[no-untyped-def]
    """Keys and numbers of the points from `start` on that are near, from `start` on; returns their end."""
    end = start
    for i in range(start, stop):
        if valid[i]:
            x = _cell(xyz[i, 0], size) - lowest[0]
            y = _cell(xyz[i, 1], size) - lowest[1]
            z = _cell(xyz[i, 2], size) - lowest[2]
            if marks.size:
                tower = marks[x >> BLOCK & _SIDE - 1, y >> BLOCK & _SIDE - 1]
                if not tower >> np.uint32(z >> BLOCK & _HEIGHT - 1) & np.uint32(1):
                    continue
            keys[end] = _spread(x) << 2 | _spread(y) << 1 | _spread(z)
            points[end] = i
            end += 1
    return end


@kernel
def _sort(keys, points, bits):  # type: ignore[no-untyped-def]
    """Stable radix sort of `points` by the lowest `bits` bits of `keys`."""
    other_keys = np.empty_like(keys)
    other_points = np.empty_like(points)
    places = np.empty(2048, np.int64)
    for shift in range(0, bits, 11):
        for digit in range(2048):
            places[digit] = 0
        for i in range(keys.size):
            places[(keys[i] >> shift) & 2047] += 1
        total = 0
        for digit in range(2048):
            number = places[digit]
            places[digit] = total
            total += number
        for i in range(keys.size):
            digit = (keys[i] >> shift) & 2047
            place = places[digit]
            places[digit] += 1
            other_keys[place] = keys[i]
            other_points[place] = points[i]
        keys, other_keys = other_keys, keys
        points, other_points = other_points, points
    return keys, points


@kernel
def _group(keys):  # type: ignore[no-untyped-def]
    """The different ones of rising keys, and where each begins."""
    voxels = 0
    for i in range(keys.size):
        voxels += i == 0 or keys[i] != keys[i - 1]
    unique = np.empty(voxels, np.int64)
    starts = np.empty(voxels + 1, np.int32)
    v = 0
    for i in range(keys.size):
        if i == 0 or keys[i] != keys[i - 1]:
            unique[v], starts[v] = keys[i], i
            v += 1
    starts[voxels] = keys.size
    return unique, starts


@kernel
def _coordinates(keys):  # type: ignore[no-untyped-def]
    coords = np.empty((keys.size, 3), np.int32)
    for i in range(keys.size):
        coords[i, 0] = _gather_bits(keys[i] >> 2)
        coords[i, 1] = _gather_bits(keys[i] >> 1)
        coords[i, 2] = _gather_bits(keys[i])
    return coords

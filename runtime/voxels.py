"""Points to voxels: one row per occupied voxel, in Morton order, so that near voxels lie near in memory."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.errors import ScanError
from runtime.jit import inlined, kernel
from runtime.workers import Workers

AXIS_BITS = 21  # three axes fill 63 bits of a key
_GRAIN = 32_768  # points per task
_FAR = 1 << 30  # voxels; farther points cannot be counted in 32 bits
_COLUMNS, _COLUMN_BITS = 512, 3  # columns of 2^3 voxels in x and y; what is 512 of them apart shares one


@dataclass(frozen=True)
class Voxels:
    """The occupied voxels of a scan. V voxels, N points, M of them in a voxel."""

    keys: NDArray[np.int64]  # (V,) Morton keys, rising; x in bit 2 of each triple, y in bit 1, z in bit 0
    coords: NDArray[np.int32]  # (V, 3) x y z in voxels, minimum over the scan = 0 on each axis
    first: NDArray[np.int32]  # (V,) the first point of the voxel in scan order
    inverse: NDArray[np.int32]  # (N,) the voxel of each point, -1 for points that were left out
    order: NDArray[np.int32]  # (M,) points sorted by voxel, in scan order within one
    starts: NDArray[np.int32]  # (V + 1,) points of voxel v: order[starts[v] : starts[v + 1]]


def voxelise(
    xyz: NDArray[np.float32],
    voxel_size: float,
    workers: Workers,
    valid: NDArray[np.bool_] | None = None,
    near: tuple[NDArray[np.bool_], int] | None = None,
) -> Voxels:
    """Voxels of a scan: `q = round(xyz / voxel_size)` in float32, ties to even, minus the minimum per axis.

    `xyz` (N, 3) float32 m; `valid` (N,) bool: points to use, by default all but those at the origin. Points
    with NaN or infinite coordinates are always left out. `near`: candidates (N,) bool and a distance in voxels;
    saves the work for voxels that are farther in x or y from those of all candidates (not for each of them), on the
    grid of the whole scan. Raises ScanError where the scan spans 2^21 voxels.
    """
    xyz = np.require(xyz, np.float32, ["W"])  # columns of a wider array are read where they are
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ScanError(f"a scan's coordinates must be (N, 3), not {xyz.shape}")
    mask = xyz.any(axis=1) if valid is None else np.require(valid, np.bool_, ["C", "W"])
    if mask.shape != xyz.shape[:1]:
        raise ScanError(f"the mask of valid points must be ({len(xyz)},), not {mask.shape}")
    count = len(xyz)
    cells = np.empty((count, 3), np.int32)
    used = np.empty(count, np.bool_)
    tasks = -(-count // _GRAIN)
    extents = np.empty((tasks, 7), np.int64)  # minima, maxima and number of the points of each task

    def quantise(start: int, stop: int) -> None:
        _quantise(xyz, np.float32(voxel_size), mask, cells, used, extents, start // _GRAIN, start, stop)

    workers.ranges(quantise, count, _GRAIN)
    total = int(extents[:, 6].sum())
    lowest = extents[:, :3].min(axis=0) if total else np.zeros(3, np.int64)
    span = extents[:, 3:6].max(axis=0) - lowest if total else np.zeros(3, np.int64)
    if total and (span.max() >> AXIS_BITS or np.abs(extents[:, :6]).max() >= _FAR):
        raise ScanError(
            f"the scan spans {np.abs(extents[:, :6]).max() * voxel_size:.3g} m or more, too far for "
            f"{1 << AXIS_BITS} voxels of {voxel_size} m: drop the far points or use larger voxels"
        )
    if near is not None:
        columns = np.zeros((_COLUMNS, _COLUMNS), np.bool_)
        _mark_columns(cells, used, np.require(near[0], np.bool_), near[1], columns)
        workers.ranges(
            lambda start, stop: _select(cells, used, columns, extents, start // _GRAIN, start, stop), count, _GRAIN
        )
    offsets = np.concatenate(([0], np.cumsum(extents[:, 6])))
    total = int(offsets[-1])
    keys = np.empty(total, np.int64)
    points = np.empty(total, np.int32)
    workers.ranges(
        lambda start, stop: _keys(cells, used, lowest, keys, points, offsets[start // _GRAIN], start, stop),
        count,
        _GRAIN,
    )
    keys, points = _sort(keys, points, 3 * int(span.max()).bit_length())
    return Voxels(*_group(keys, points, count))


@kernel
def _quantise(xyz, size, valid, cells, used, extents, task, start, stop):  # type: ignore[no-untyped-def]
    for axis in range(3):
        extents[task, axis] = _FAR
        extents[task, 3 + axis] = -_FAR
    number = 0
    for i in range(start, stop):
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        keep = valid[i] and np.isfinite(x) and np.isfinite(y) and np.isfinite(z)
        used[i] = keep
        if not keep:
            continue
        number += 1
        for axis in range(3):
            cell = np.rint(xyz[i, axis] / size)
            q = np.int64(min(max(cell, np.float32(-_FAR)), np.float32(_FAR)))
            cells[i, axis] = q
            extents[task, axis] = min(extents[task, axis], q)
            extents[task, 3 + axis] = max(extents[task, 3 + axis], q)
    extents[task, 6] = number


@kernel
def _mark_columns(cells, used, candidates, reach, columns):  # type: ignore[no-untyped-def]
    for i in range(candidates.size):
        if candidates[i] and used[i]:
            for x in range((cells[i, 0] - reach) >> _COLUMN_BITS, ((cells[i, 0] + reach) >> _COLUMN_BITS) + 1):
                for y in range((cells[i, 1] - reach) >> _COLUMN_BITS, ((cells[i, 1] + reach) >> _COLUMN_BITS) + 1):
                    columns[x & (_COLUMNS - 1), y & (_COLUMNS - 1)] = True


@kernel
def _select(cells, used, columns, extents, task, start, stop):  # type: ignore[no-untyped-def]
    number = 0
    for i in range(start, stop):
        if used[i]:
            x, y = cells[i, 0] >> _COLUMN_BITS, cells[i, 1] >> _COLUMN_BITS
            used[i] = columns[x & (_COLUMNS - 1), y & (_COLUMNS - 1)]
            number += used[i]
    extents[task, 6] = number


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
def _keys(cells, used, lowest, keys, points, offset, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        if used[i]:
            x = np.int64(cells[i, 0]) - lowest[0]
            y = np.int64(cells[i, 1]) - lowest[1]
            z = np.int64(cells[i, 2]) - lowest[2]
            keys[offset] = _spread(x) << 2 | _spread(y) << 1 | _spread(z)
            points[offset] = i
            offset += 1


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
def _group(keys, points, count):  # type: ignore[no-untyped-def]
    """One voxel for each run of equal keys."""
    voxels = 0
    for i in range(keys.size):
        voxels += i == 0 or keys[i] != keys[i - 1]
    unique = np.empty(voxels, np.int64)
    coords = np.empty((voxels, 3), np.int32)
    first = np.empty(voxels, np.int32)
    starts = np.empty(voxels + 1, np.int32)
    inverse = np.empty(count, np.int32)
    for i in range(count):
        inverse[i] = -1
    v = -1
    for i in range(keys.size):
        key = keys[i]
        if i == 0 or key != keys[i - 1]:
            v += 1
            unique[v] = key
            first[v] = points[i]
            starts[v] = i
            coords[v, 0] = _gather_bits(key >> 2)
            coords[v, 1] = _gather_bits(key >> 1)
            coords[v, 2] = _gather_bits(key)
        inverse[points[i]] = v
    starts[voxels] = keys.size
    return unique, coords, first, inverse, points, starts

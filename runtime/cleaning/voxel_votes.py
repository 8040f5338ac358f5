"""What the scans of a recording found in each voxel of the world: a table that grows, and the map that it holds."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.compute.arguments import need
from runtime.compute.hashing import hash_of
from runtime.compute.jit import inlined, kernel
from runtime.errors import SettingError

SMALLEST = 0.01  # m
FIRST_ROWS = 1 << 16  # a power of 2
FULL = 0.6  # share of the rows in use, beyond which there must be twice as many
_FREE = np.int64(-1)
# Of each row: its key, the last scan that saw the voxel, how many did, and of them how many saw it move; how many
# points are in it, and the sums of their places within the voxel, in m, and of their remission
Rows = tuple[NDArray[Any], ...]
_HALF = 1 << 20  # voxels from the origin on each axis; 21 bits of a key are theirs


@dataclass(frozen=True)
class StaticMap:
    """A point for each voxel that holds something static, in the order of their keys."""

    points: NDArray[np.float32]  # (M, 3) m, the mean of the points in it
    remission: NDArray[np.float32]  # (M,) their mean
    scans: NDArray[np.int32]  # (M,) that saw something there


@dataclass(frozen=True)
class MovingVoxels:
    """Voxels that move, in the order of the scans that saw them last."""

    rows: NDArray[np.int64]  # (M,) in the table, until something is added
    places: NDArray[np.float64]  # (M, 3) m, their middles
    last: NDArray[np.int32]  # (M,) numbers of these scans, from 1
    size: float  # of a voxel, m


class VoxelVotes:
    """Every scan has a vote on each voxel in which it saw something: it moves, if any point there is labelled so.

    A voxel moves if more than half of the votes say so. What was missed of a mover in one scan, another has found in
    the same place; what was a false alarm in one scan, others saw standing. Not for concurrent calls.
    """

    def __init__(self, size: float) -> None:
        """size: of a voxel, m. Raises SettingError."""
        if not size >= SMALLEST:
            raise SettingError(f"`voxel` must be at least {SMALLEST} m, not {size}")
        self._inverse = 1 / size
        self._size = size
        self._scans = self._used = 0
        self._rows: Rows = _empty(FIRST_ROWS)

    def __len__(self) -> int:
        """Voxels in which anything was seen."""
        return self._used

    def add(self, points: NDArray[np.float64], remission: NDArray[np.float32], moving: NDArray[np.bool_]) -> None:
        """The votes of a scan: points (N, 3) m in the world, remission (N,), and what moves of them (N,).

        Points that are not finite, or 2^20 voxels from the origin, are in no voxel. Raises ScanError.
        """
        need(points, "points", (None, 3), np.float64)
        need(remission, "remission", (len(points),), np.float32)
        need(moving, "moving", (len(points),), np.bool_)
        while self._used + len(points) > FULL * len(self._rows[0]):
            grown = _empty(2 * len(self._rows[0]))
            _move(*self._rows, *grown)
            self._rows = grown
        self._scans += 1
        self._used += _add(points, remission, moving, self._inverse, self._scans, *self._rows)

    def moves(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) m are in voxels that move. Raises ScanError."""
        need(points, "points", (None, 3), np.float64)
        found = np.empty(len(points), np.bool_)
        _look_up(points, self._inverse, *self._rows[:4], found)
        return found

    def moving(self) -> MovingVoxels:
        """All voxels that move."""
        keys, last, seen, moved, *_ = self._rows
        rows = np.flatnonzero((keys != _FREE) & (2 * moved > seen))
        rows = rows[np.lexsort((keys[rows], np.abs(last[rows])))]
        return MovingVoxels(rows, self._corners(keys[rows]) + self._size / 2, np.abs(last[rows]), self._size)

    def take_back(self, rows: NDArray[np.int64]) -> None:
        """What is in these rows stands still after all."""
        self._rows[3][rows] = 0

    def _corners(self, keys: NDArray[np.int64]) -> NDArray[np.float64]:
        """(V, 3) m, of the voxels."""
        return np.stack([(keys >> shift & (2 * _HALF - 1)) - _HALF for shift in (42, 21, 0)], 1) * self._size

    def static_map(self) -> StaticMap:
        """What is left where nothing moves."""
        keys, _, seen, moved, count, sums = self._rows
        rows = np.flatnonzero((keys != _FREE) & (2 * moved <= seen))
        rows = rows[np.argsort(keys[rows])]
        means = sums[rows] / count[rows, None]
        points = (self._corners(keys[rows]) + means[:, :3]).astype(np.float32)
        return StaticMap(points, means[:, 3].astype(np.float32), seen[rows])


def _empty(rows: int) -> Rows:
    numbers = [np.zeros(rows, np.int32) for _ in range(4)]
    return np.full(rows, _FREE), *numbers, np.zeros((rows, 4), np.float32)


@inlined
def _key_of(x, y, z, inverse):  # type: ignore[no-untyped-def]
    """-1 for points that are in no voxel."""
    a, b, c = np.floor(x * inverse), np.floor(y * inverse), np.floor(z * inverse)
    if not (abs(a) < _HALF and abs(b) < _HALF and abs(c) < _HALF):  # NaN is in none
        return np.int64(-1)
    return ((np.int64(a) + _HALF) << 42) | ((np.int64(b) + _HALF) << 21) | (np.int64(c) + _HALF)


@inlined
def _row_of(key, keys):  # type: ignore[no-untyped-def]
    """The row of a key, or the free one that is to be its."""
    mask = np.uint64(keys.size - 1)
    row = hash_of(hash_of(key)) & mask  # once would leave out most of x
    while keys[row] != key and keys[row] != _FREE:
        row = (row + np.uint64(1)) & mask
    return row


@kernel
def _add(points, remission, moving, inverse, scan, keys, last, seen, moved, count, sums):  # type: ignore[no-untyped-def]
    """Of `last`, a negative number is that of a scan which saw the voxel move. Returns how many voxels are new."""
    new = 0
    for i in range(points.shape[0]):
        key = _key_of(points[i, 0], points[i, 1], points[i, 2], inverse)
        if key < 0:
            continue
        row = _row_of(key, keys)
        if keys[row] == _FREE:
            keys[row] = key
            new += 1
        if abs(last[row]) != scan:
            last[row] = scan
            seen[row] += 1
        if moving[i] and last[row] > 0:
            last[row] = -scan
            moved[row] += 1
        count[row] += 1
        for k in range(3):
            sums[row, k] += np.float32(points[i, k] - np.floor(points[i, k] * inverse) / inverse)
        sums[row, 3] += remission[i]
    return new


@kernel
def _move(keys, last, seen, moved, count, sums, keys_2, last_2, seen_2, moved_2, count_2, sums_2):  # type: ignore[no-untyped-def]
    """Rows into a larger table."""
    for row in range(keys.size):
        if keys[row] != _FREE:
            to = _row_of(keys[row], keys_2)
            keys_2[to], last_2[to], seen_2[to], moved_2[to] = keys[row], last[row], seen[row], moved[row]
            count_2[to] = count[row]
            for k in range(4):
                sums_2[to, k] = sums[row, k]


@kernel
def _look_up(points, inverse, keys, last, seen, moved, found):  # type: ignore[no-untyped-def]
    for i in range(points.shape[0]):
        key = _key_of(points[i, 0], points[i, 1], points[i, 2], inverse)
        found[i] = False
        if key >= 0:
            row = _row_of(key, keys)
            found[i] = keys[row] == key and 2 * moved[row] > seen[row]

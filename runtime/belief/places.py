"""The places that one scan saw: voxels that stand still in the world, and what was found in each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.belief.free_space import Sight
from runtime.compute.arena import Arena
from runtime.compute.arguments import need
from runtime.compute.hashing import slot_of
from runtime.compute.jit import inlined, kernel
from runtime.compute.workers import Workers

MOST = np.float32(9.21)  # log-odds of a probability of 0.9999: a network is never surer than that
# From a place to the 26 around it and itself, in voxels; from one of the first half to the other is back again
AROUND = np.array(list(np.ndindex(3, 3, 3)), np.int64) - 1
_BITS = 21  # of a voxel's number on each axis; numbers repeat after 2^21 voxels, which no sensor sees across
_GRAIN = 16_384  # points per task
_NOWHERE = np.int64(-1)  # key of points that take no part; of a voxel all keys are above 0
_NONE = np.int32(-1)


@dataclass(frozen=True)
class Places:
    """The voxels of a scan, V in all, in the order of their first points. Arrays are buffers of the `Surveyor`."""

    keys: NDArray[np.int64]  # (V,) of the world, not of the scan: the same place has the same key in every scan
    evidence: NDArray[np.float32]  # (V,) mean log-odds of its points that they move
    place: NDArray[np.int32]  # (N,) the voxel of each point; -1: takes no part
    log_odds: NDArray[np.float32]  # (N,) of each point
    sight: Sight  # the scan

    def copy(self) -> "Places":
        """In arrays of its own."""
        keys, evidence, place, log_odds = (
            self.keys.copy(),
            self.evidence.copy(),
            self.place.copy(),
            self.log_odds.copy(),
        )
        return Places(keys, evidence, place, log_odds, self.sight.copy())


class Surveyor:
    """Finds the places of scans, with buffers that are reused. Not for concurrent calls."""

    def __init__(self, voxel_size: float, workers: Workers) -> None:
        """voxel_size: m."""
        self._size, self._workers, self._arena = voxel_size, workers, Arena()

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return self._arena.nbytes

    def survey(self, sight: Sight, takes_part: NDArray[np.bool_], probability: NDArray[np.float32]) -> Places:
        """Places of a scan, by which of its points take part (N,), and the probability (N,) that each of them moves.

        Voxels are those of the world's grid, counted in float64: a scan's places depend on nothing but itself. Raises
        ScanError.
        """
        need(sight.points, "points", (None, 4), np.float32)
        need(takes_part, "takes_part", sight.points.shape[:1], np.bool_)
        need(probability, "probability", sight.points.shape[:1], np.float32)
        self._arena.next_scan()
        count, take = len(sight.points), self._arena.take
        to_voxels = np.ascontiguousarray(sight.pose[:3] / self._size)
        of_point = take("of_point", (count,), np.int64)
        log_odds = take("log_odds", (count,))
        self._workers.ranges(
            lambda start, stop: _look(
                sight.points[start:stop],
                takes_part[start:stop],
                to_voxels,
                probability[start:stop],
                of_point[start:stop],
                log_odds[start:stop],
            ),
            count,
            _GRAIN,
        )
        place = take("place", (count,), np.int32)
        keys, evidence = take("keys", (count,), np.int64), take("evidence", (count,))
        seen = take("seen", (count,), np.int32)
        slots = take("slots", (1 << max(4, (2 * count - 1).bit_length()),), np.int32)
        found = _gather(of_point, log_odds, slots, place, keys, evidence, seen)
        return Places(keys[:found], evidence[:found], place, log_odds, sight)


@inlined
def neighbour(key, step):  # type: ignore[no-untyped-def]
    """The key of the voxel that lies `step` (3,) int64 voxels from that of a key."""
    mask = np.int64((1 << _BITS) - 1)
    x = (key >> 2 * _BITS) + step[0] & mask
    y = (key >> _BITS) + step[1] & mask
    return (x << _BITS | y) << _BITS | key + step[2] & mask


@kernel
def _look(points, takes_part, to_voxels, probability, of_point, log_odds):  # type: ignore[no-untyped-def]
    """Key and log-odds of every point."""
    mask = np.int64((1 << _BITS) - 1)
    for i in range(points.shape[0]):
        p = probability[i]
        value = np.log(p / (np.float32(1) - p))
        log_odds[i] = min(max(value, -MOST), MOST)
        of_point[i] = _NOWHERE
        if takes_part[i]:
            px, py, pz = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
            x = to_voxels[0, 0] * px + to_voxels[0, 1] * py + to_voxels[0, 2] * pz + to_voxels[0, 3]
            y = to_voxels[1, 0] * px + to_voxels[1, 1] * py + to_voxels[1, 2] * pz + to_voxels[1, 3]
            z = to_voxels[2, 0] * px + to_voxels[2, 1] * py + to_voxels[2, 2] * pz + to_voxels[2, 3]
            key = np.int64(np.floor(x)) & mask
            key = key << _BITS | np.int64(np.floor(y)) & mask
            of_point[i] = key << _BITS | np.int64(np.floor(z)) & mask


@kernel
def _gather(of_point, log_odds, slots, place, keys, evidence, seen):  # type: ignore[no-untyped-def]
    """Number the voxels, and average the log-odds of their points in scan order; returns how many there are."""
    slots[:] = _NONE
    found = np.int32(0)
    before, at = _NOWHERE, _NONE
    for i in range(of_point.size):
        key = of_point[i]
        if key != before:  # neighbours in a scan lie in one voxel more often than not
            before, at = key, _NONE
            if key != _NOWHERE:
                slot = slot_of(slots, keys, key)
                if slots[slot] == _NONE:
                    slots[slot] = found
                    keys[found], evidence[found], seen[found] = key, np.float32(0), 0
                    found += np.int32(1)
                at = slots[slot]
        place[i] = at
        if at != _NONE:
            evidence[at] += log_odds[i]
            seen[at] += 1
    for v in range(found):
        evidence[v] /= np.float32(seen[v])
    return found

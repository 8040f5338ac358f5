"""What past scans found at each place: a hash of voxels that is bounded in memory and in time.

Voxels of one hash share a set of `WAYS` rows. Where a set is full, the voxel that was seen longest ago gives way, and
of those of one scan the one with the smallest key. So what a set holds depends on nothing that is older than it.
Evidence is kept in whole numbers, whose sums do not depend on how they came about. Both together: what is recalled
depends on the last scans alone, to the last bit, however long the drive was.
"""

import numpy as np
from numpy.typing import NDArray

from runtime.compute.arena import aligned_empty
from runtime.compute.arguments import need
from runtime.compute.hashing import hash_of
from runtime.compute.jit import kernel
from runtime.compute.workers import Workers

WAYS = 8  # rows of a set: their keys fill one cache line
SETS = 32_768  # 262,144 voxels; the last 16 scans of an HDL-64E see a third as many
STEPS = 2048  # of kept evidence in 1 of log-odds: 16 bits hold +-16
_FREE = np.int64(-1)
_PARTS = 4  # of the sets, written side by side
_GRAIN = 4096  # voxels per task


class Memory:
    """The sum of the evidence of the last `horizon` scans by voxel. Not for concurrent calls."""

    def __init__(self, horizon: int, workers: Workers, sets: int = SETS) -> None:
        """horizon: scans that count; sets: a power of 2."""
        self._workers = workers
        self._keys = aligned_empty((sets, WAYS), np.int64)
        self._last = aligned_empty((sets, WAYS), np.int32)  # the scan that saw the voxel last
        self._total = aligned_empty((sets, WAYS), np.int32)  # steps, of the `horizon` scans up to that one
        self._steps = aligned_empty((sets, WAYS, horizon), np.int16)  # of each of them: of scan s at s % horizon
        self.clear()

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(one.nbytes for one in self._tables)

    @property
    def _tables(self) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32], NDArray[np.int16]]:
        return self._keys, self._last, self._total, self._steps

    def clear(self) -> None:
        """Forget everything."""
        self._keys[:] = _FREE
        self._last[:] = 0
        self._scans = 0  # since then

    def recall(self, keys: NDArray[np.int64]) -> NDArray[np.float32]:
        """The sum (V,) of the evidence that past scans found at the voxels `keys` (V,); 0 where there is none.

        Raises ScanError.
        """
        need(keys, "keys", (None,), np.int64)
        found = np.empty(len(keys), np.float32)
        self._workers.ranges(
            lambda start, stop: _recall(keys[start:stop], self._scans, *self._tables, found[start:stop]),
            len(keys),
            _GRAIN,
        )
        return found

    def add(self, keys: NDArray[np.int64], evidence: NDArray[np.float32]) -> None:
        """Keep the evidence (V,), within +-15, that a scan found at its voxels, each of them once in `keys` (V,).

        Raises ScanError.
        """
        need(keys, "keys", (None,), np.int64)
        need(evidence, "evidence", keys.shape, np.float32)
        self._workers.each(lambda part: _add(keys, evidence, self._scans, part, *self._tables), _PARTS)
        self._scans += 1


@kernel
def _recall(wanted, now, keys, last, total, steps, found):  # type: ignore[no-untyped-def]
    horizon = steps.shape[2]
    mask = np.uint64(keys.shape[0] - 1)
    for v in range(wanted.size):
        at = hash_of(wanted[v]) & mask
        found[v] = np.float32(0)
        for way in range(WAYS):
            if keys[at, way] == wanted[v]:
                seen = last[at, way]
                if seen < now - horizon:
                    break
                left = total[at, way]
                for scan in range(max(seen - horizon + 1, 0), now - horizon):  # too old by now
                    left -= steps[at, way, scan % horizon]
                found[v] = np.float32(left) / np.float32(STEPS)
                break


@kernel
def _add(given, evidence, now, part, keys, last, total, steps):  # type: ignore[no-untyped-def]
    """Those of the voxels whose sets are of this part."""
    horizon = steps.shape[2]
    mask = np.uint64(keys.shape[0] - 1)
    own = now % horizon
    for v in range(given.size):
        at = hash_of(given[v]) & mask
        if at % np.uint64(_PARTS) != np.uint64(part):
            continue
        way = _row_for(given[v], at, keys, last)
        if keys[at, way] == given[v]:
            for scan in range(max(last[at, way] + 1, now - horizon + 1), now):  # not seen then: the slots hold older
                total[at, way] -= steps[at, way, scan % horizon]
                steps[at, way, scan % horizon] = 0
        elif keys[at, way] == _FREE or last[at, way] < now:
            keys[at, way], total[at, way] = given[v], 0
            for slot in range(horizon):
                steps[at, way, slot] = 0
        else:
            continue  # this scan alone fills the set
        step = np.int16(np.rint(evidence[v] * np.float32(STEPS)))
        total[at, way] += step - steps[at, way, own]
        steps[at, way, own] = step
        last[at, way] = now


@kernel
def _row_for(key, at, keys, last):  # type: ignore[no-untyped-def]
    """The row of set `at` that holds `key`, or else is free, or else gives way."""
    row = 0
    for other in range(WAYS):
        if keys[at, other] == key:
            return other
        if keys[at, row] != _FREE:
            older = last[at, other] < last[at, row] or (
                last[at, other] == last[at, row] and keys[at, other] < keys[at, row]
            )
            if keys[at, other] == _FREE or older:
                row = other
    return row

"""Where a scan enters: the one pass that says which points take part, and fills in missing remission."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.compute.jit import kernel
from runtime.compute.workers import Workers
from runtime.recordings.scans import check_scan

_GRAIN = 32_768  # points per task


@dataclass(frozen=True)
class Entered:
    """A scan that is ready for the network. Everything after takes its mask."""

    points: NDArray[np.float32]  # (N, 4) x, y, z in m, LiDAR frame, and remission, which is finite
    takes_part: NDArray[np.bool_]  # (N,) finite, not at the origin, within reach; the others are never moving

    def __len__(self) -> int:
        return len(self.points)


class Entry:
    """Takes scans in, with a buffer that is reused. Not for concurrent calls."""

    def __init__(self, remission: float, reach: float, workers: Workers) -> None:
        """remission: stands in for what is missing; the mean that the network subtracts, so that it becomes 0.

        reach: m, farther points do not take part.
        """
        self._remission, self._reach, self._workers = np.float32(remission), np.float32(reach), workers
        self._buffer = np.empty((0, 4), np.float32)

    def enter(self, scan: ArrayLike) -> Entered:
        """A scan (N, 4) or (N, 3) f32 or f64, x, y, z in m, LiDAR frame, and remission in 0..1 if it is known.

        Remission that is missing or not finite is filled in. `points` of what is returned is a buffer that the next
        call reuses. Raises ScanError for another shape or dtype.
        """
        given = check_scan(scan)
        count, columns = given.shape
        if len(self._buffer) < count:
            self._buffer = np.empty((count + count // 8, 4), np.float32)
        points = self._buffer[:count]
        with np.errstate(over="ignore"):  # float64 beyond the range of float32 becomes infinite
            points[:, :columns] = given
        if columns == 3:
            points[:, 3] = self._remission
        takes_part = np.empty(count, np.bool_)
        self._workers.ranges(
            lambda start, stop: _enter(points[start:stop], self._remission, self._reach, takes_part[start:stop]),
            count,
            _GRAIN,
        )
        return Entered(points, takes_part)


@kernel
def _enter(points, remission, reach, takes_part):  # type: ignore[no-untyped-def]
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        r = np.sqrt(x * x + y * y + z * z)
        takes_part[i] = r > np.float32(0) and r <= reach  # neither holds for NaN
        if not np.isfinite(points[i, 3]):
            points[i, 3] = remission

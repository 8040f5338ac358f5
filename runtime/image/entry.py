"""Where a scan enters: the one pass that says which points take part, and fills in missing remission."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.compute.arena import Arena
from runtime.compute.jit import kernel
from runtime.compute.workers import Workers
from runtime.recordings.scans import check_scan

_GRAIN = 32_768  # points per task


@dataclass(frozen=True)
class Entered:
    """A scan that is ready for the network. Everything after takes its mask."""

    points: NDArray[np.float32]  # (N, 4) x, y, z in m, the sensor's frame, and remission, which is finite
    # (N,) finite, not at the origin, within reach, none of the carrier; the others are never moving
    takes_part: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points)


class Entry:
    """Takes scans in, with a buffer that is reused. Not for concurrent calls."""

    def __init__(
        self,
        remission: float,
        reach: float,
        workers: Workers,
        nearest: float = 0.0,
        body: Sequence[float] | None = None,
        mounting: NDArray[np.float64] | None = None,
    ) -> None:
        """remission: stands in for what is missing; the mean that the network subtracts, so that it becomes 0.

        reach: m, farther points do not take part. nearest: m, nor do nearer ones. body: m, x y z of two corners of a
        box, nor do points within. mounting: (4, 4) T_sensor_scan, of scans in another frame than that of their sensor.
        """
        self._remission, self._workers = np.float32(remission), workers
        self._limits = np.array((nearest, reach), np.float32)
        corners = np.full((2, 3), np.inf, np.float32) if body is None else np.reshape(body, (2, 3)).astype(np.float32)
        self._box = np.stack([corners.min(0), corners.max(0)])
        self._mounting = None if mounting is None else np.ascontiguousarray(mounting[:3], np.float32)
        self._arena = Arena()

    def enter(self, scan: ArrayLike) -> Entered:
        """A scan (N, 4) or (N, 3) f32 or f64, x, y, z in m, LiDAR frame, and remission in 0..1 if it is known.

        Remission that is missing or not finite is filled in. `points` of what is returned is a buffer that the next
        call reuses. Raises ScanError for another shape or dtype.
        """
        given = check_scan(scan)
        count, columns = given.shape
        self._arena.next_scan()
        points = self._arena.take("points", (count, 4))
        with np.errstate(over="ignore"):  # float64 beyond the range of float32 becomes infinite
            points[:, :columns] = given
        if columns == 3:
            points[:, 3] = self._remission
        takes_part = np.empty(count, np.bool_)
        self._workers.ranges(
            lambda start, stop: _enter(
                points[start:stop], self._remission, self._limits, self._box, takes_part[start:stop]
            ),
            count,
            _GRAIN,
        )
        if (mounting := self._mounting) is not None:
            self._workers.ranges(lambda start, stop: _move(points[start:stop], mounting), count, _GRAIN)
        return Entered(points, takes_part)


@kernel
def _enter(points, remission, limits, box, takes_part):  # type: ignore[no-untyped-def]
    nearest, reach = limits
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        r = np.sqrt(x * x + y * y + z * z)
        inside = box[0, 0] <= x <= box[1, 0] and box[0, 1] <= y <= box[1, 1] and box[0, 2] <= z <= box[1, 2]
        takes_part[i] = r > np.float32(0) and nearest <= r <= reach and not inside  # no comparison holds for NaN
        if not np.isfinite(points[i, 3]):
            points[i, 3] = remission


@kernel
def _move(points, transform):  # type: ignore[no-untyped-def]
    """Points (n, 4) by a transform (3, 4), in place."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for axis in range(3):
            t = transform[axis]
            points[i, axis] = t[0] * x + t[1] * y + t[2] * z + t[3]

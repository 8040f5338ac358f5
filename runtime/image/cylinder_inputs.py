"""Points of a scan and of those before it in the cells of a cylinder around the sensor, with the time as a feature.

An image of one row: a column for each point of the scan, in its order, then for each of the past scans, as seen now.
Its channels, of a point: from the middle of its cell to the point, outwards (m), around (rad) and up (m); the same from
the axis, as distance, angle and z; x and y (m); remission, normalised, and 0 for past scans; time, in scans back. Last
comes the number of its cell; -1 and zeros: it takes no part, or is out of the cylinder.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.residual import Residual
from runtime.bundle.view import POINT_CHANNELS, CylinderView
from runtime.compute.arena import Arena
from runtime.compute.jit import fast_kernel, inlined
from runtime.compute.workers import Workers
from runtime.image.entry import Entered
from runtime.image.history import Past
from runtime.image.inputs import ImageInput, Inputs, Projected, normalised_remission
from runtime.sensors.range_image import RangeImage

_GRAIN = 16_384  # points per task


@inlined
def _describe(x, y, z, geometry, row):  # type: ignore[no-untyped-def]
    """The channels of a point, but for remission and time, into `row`; whether it is in the cylinder."""
    rings, sectors, layers, ring, sector, layer, bottom = geometry
    distance, angle = np.sqrt(x * x + y * y), np.float32(math.atan2(y, x))
    u = np.floor(distance / ring)
    v = min(np.floor((angle + np.float32(math.pi)) / sector), np.float32(sectors - 1))  # the angle may be all of pi
    w = np.floor((z - bottom) / layer)
    inside = (u < np.float32(rings)) & (v >= np.float32(0)) & (w >= np.float32(0)) & (w < np.float32(layers))
    if not inside:  # no comparison holds for NaN
        row[:] = np.float32(0)
        row[POINT_CHANNELS] = np.float32(-1)
        return False
    half = np.float32(0.5)
    row[0] = distance - (u + half) * ring
    row[1] = angle + np.float32(math.pi) - (v + half) * sector
    row[2] = z - bottom - (w + half) * layer
    row[3], row[4], row[5], row[6], row[7] = distance, angle, z, x, y
    row[POINT_CHANNELS] = np.float32((np.int64(u) * sectors + np.int64(v)) * layers + np.int64(w))
    return True


@fast_kernel
def describe_scan(points, takes_part, geometry, mean, std, start, stop, rows, pixel, distance):  # type: ignore[no-untyped-def]
    """The current scan, points (N, 4) f32 m and remission, from `start` to `stop`.

    Writes rows (N, 11) f32, the channels; pixel (N,) int32, the point's number or -1; distance (N,) f32 m, its range.
    """
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        row = rows[i]
        pixel[i], distance[i] = -1, np.float32(0)
        if not takes_part[i]:
            row[:] = np.float32(0)
            row[POINT_CHANNELS] = np.float32(-1)
        elif _describe(x, y, z, geometry, row):
            row[8], row[9] = normalised_remission(points[i, 3], mean, std), np.float32(0)
            pixel[i], distance[i] = i, np.sqrt(x * x + y * y + z * z)


@fast_kernel
def describe_past(points, transform, lag, geometry, start, stop, rows):  # type: ignore[no-untyped-def]
    """The channels (M, 11) f32 of a past scan (M, >= 3) f32 m that is moved by `transform` (3, 4) f32."""
    t = transform
    for i in range(start, stop):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = t[0, 0] * px + t[0, 1] * py + t[0, 2] * pz + t[0, 3]
        y = t[1, 0] * px + t[1, 1] * py + t[1, 2] * pz + t[1, 3]
        z = t[2, 0] * px + t[2, 1] * py + t[2, 2] * pz + t[2, 3]
        if _describe(x, y, z, geometry, rows[i]):
            rows[i, 8], rows[i, 9] = np.float32(0), lag


class CylinderInputBuilder(Inputs):
    """The current scan and each past one, point by point."""

    def __init__(
        self, cylinder: CylinderView, range_image: RangeImage, residual: Residual, workers: Workers, *entry: Any
    ) -> None:
        """range_image: of the sensor, whose remission is normalised. entry: reach and more, as of `Inputs`."""
        super().__init__(range_image, residual, workers, *entry)
        sizes = cylinder.radius / cylinder.rings, 2 * math.pi / cylinder.sectors
        height = (cylinder.top - cylinder.bottom) / cylinder.layers
        self._geometry = *cylinder.cells, *map(np.float32, (*sizes, height, cylinder.bottom))
        self._arena = Arena()
        self._rows = np.empty((0, POINT_CHANNELS + 1), np.float32)

    def project(self, scan: Entered, past: Sequence[Past | None]) -> Projected:
        """See `Inputs`."""
        befores = [(lag, one) for lag, one in zip(self._lags, self._befores(past), strict=True) if one is not None]
        pixel, distance = np.empty(len(scan), np.int32), np.empty(len(scan), np.float32)
        count = len(scan) + sum(len(one.points) for _, one in befores)
        self._arena.next_scan()
        self._rows = self._arena.take("rows", (count, POINT_CHANNELS + 1))
        given = scan.points, scan.takes_part, self._geometry, self._mean[-1], self._std[-1]
        written = self._rows, pixel, distance
        self.workers.ranges(lambda a, b: describe_scan(*given, a, b, *written), len(scan), _GRAIN)
        first = len(scan)
        for lag, before in befores:
            rows = self._rows[first : first + len(before.points)]
            transform = np.ascontiguousarray(before.relative[:3], np.float32)
            moved = before.points, transform, np.float32(lag), self._geometry
            self.workers.ranges(partial(_describe_range, moved, rows), len(rows), _GRAIN)
            first += len(rows)
        return Projected(scan, pixel, distance)

    def residuals(self, projected: Projected, past: Sequence[Past | None]) -> ImageInput:
        """See `Inputs`."""
        count = len(self._rows)
        first, nearest = np.full(count, -1, np.int32), np.zeros(count, np.float32)
        first[: len(projected.pixel)], nearest[: len(projected.pixel)] = projected.pixel, projected.distance
        return ImageInput(self._rows.T[:, None], nearest[None], first[None], projected.pixel, projected.distance)


def _describe_range(moved: tuple[Any, ...], rows: NDArray[np.float32], start: int, stop: int) -> None:
    describe_past(*moved, start, stop, rows)

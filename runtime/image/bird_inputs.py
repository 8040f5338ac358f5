"""The bird's-eye view of a scan and of those before it: the range image of a camera far above, at equal cells.

The nearest point of a cell is its highest. Channels of every scan are highest and lowest z (m, from the middle of the
view), density (1 from 63 points on, by the logarithm, as in MV3D, Chen et al., CVPR 2017) and whether there is any
point at all; the current scan has the normalised remission of the highest point besides.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.residual import Residual
from runtime.bundle.view import PAST_CHANNELS, SCAN_CHANNELS, BirdView
from runtime.compute.jit import fast_kernel, inlined
from runtime.compute.workers import Workers
from runtime.image.entry import Entered
from runtime.image.history import Past
from runtime.image.inputs import ImageInput, Inputs, Projected, normalised_remission
from runtime.sensors.range_image import RangeImage

FULL = 63  # points of a cell, at which its density is 1
DENSITY = (np.log1p(np.arange(FULL + 1)) / math.log1p(FULL)).astype(np.float32)


@inlined
def _cell(x, y, z, geometry):  # type: ignore[no-untyped-def]
    """The cell v * cells + u of a point, and its depth below the top in m; (-1, 0) out of the view."""
    cells, half, per_metre, bottom, top = geometry
    u = np.floor((half - y) * per_metre)
    v = np.floor((half - x) * per_metre)
    side = np.float32(cells)
    flat = (u >= np.float32(0)) & (u < side) & (v >= np.float32(0)) & (v < side)
    inside = flat & (z >= bottom) & (z < top)  # no comparison holds for NaN
    cell = np.int32(v * side + u if inside else np.float32(-1))  # exact: `View` has fewer cells than float32 counts
    return cell, top - z if inside else np.float32(0)


@inlined
def _add(cell, depth, nearest, deepest, count):  # type: ignore[no-untyped-def]
    nearest[cell] = min(nearest[cell], depth)
    deepest[cell] = max(deepest[cell], depth)
    count[cell] += np.float32(1)


@fast_kernel
def look_down(points, takes_part, geometry, pixel, distance, first, nearest, deepest, count):  # type: ignore[no-untyped-def]
    """The current scan, points (N, 4) f32, of which those with takes_part (N,) bool count.

    Writes for every point pixel (N,) int32 (-1: out of the view, or takes no part) and distance (N,) f32 m, its depth;
    for every cell first (C,) int32, its highest point (-1: none), and nearest (infinity: none), deepest (0) and count
    (C,) f32.
    """
    first[:] = -1
    nearest[:] = np.float32(np.inf)
    deepest[:] = np.float32(0)
    count[:] = np.float32(0)
    for i in range(points.shape[0]):
        cell, depth = _cell(points[i, 0], points[i, 1], points[i, 2], geometry)
        if cell < 0 or not takes_part[i]:
            pixel[i], distance[i] = -1, np.float32(0)
            continue
        pixel[i], distance[i] = cell, depth
        if depth < nearest[cell]:
            first[cell] = i
        _add(cell, depth, nearest, deepest, count)


@fast_kernel
def look_down_on_past(points, transform, geometry, nearest, deepest, count):  # type: ignore[no-untyped-def]
    """The cells, as of `look_down`, of a past scan (M, >= 3) f32 that is moved by `transform` (3, 4) f32."""
    nearest[:] = np.float32(np.inf)
    deepest[:] = np.float32(0)
    count[:] = np.float32(0)
    t = transform
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = t[0, 0] * px + t[0, 1] * py + t[0, 2] * pz + t[0, 3]
        y = t[1, 0] * px + t[1, 1] * py + t[1, 2] * pz + t[1, 3]
        z = t[2, 0] * px + t[2, 1] * py + t[2, 2] * pz + t[2, 3]
        cell, depth = _cell(x, y, z, geometry)
        if cell >= 0:
            _add(cell, depth, nearest, deepest, count)


@fast_kernel
def _finish(nearest, half_height, density, channels):  # type: ignore[no-untyped-def]
    """Turn channels (4, C) that hold deepest and count in 1 and 2 into those of the network; infinity becomes 0."""
    full = np.float32(density.shape[0] - 1)
    for cell in range(nearest.shape[0]):
        count = channels[2, cell]
        there = count > np.float32(0)
        channels[0, cell] = half_height - nearest[cell] if there else np.float32(0)
        channels[1, cell] = half_height - channels[1, cell] if there else np.float32(0)
        channels[2, cell] = density[np.int64(min(count, full))]
        channels[3, cell] = np.float32(1) if there else np.float32(0)


@fast_kernel
def _remission_of_highest(points, first, mean, std, nearest, channel):  # type: ignore[no-untyped-def]
    """The normalised remission of the highest points; in `nearest` infinity becomes 0."""
    for cell in range(first.shape[0]):
        i = first[cell]
        if i < 0:
            nearest[cell] = channel[cell] = np.float32(0)
        else:
            channel[cell] = normalised_remission(points[i, 3], mean, std)


class BirdInputBuilder(Inputs):
    """The current scan and each past one from above."""

    def __init__(
        self, bird: BirdView, range_image: RangeImage, residual: Residual, workers: Workers, *entry: Any
    ) -> None:
        """range_image: of the sensor, whose remission is normalised. entry: reach and more, as of `Inputs`."""
        super().__init__(range_image, residual, workers, *entry)
        self._cells, self._half_height = bird.cells, np.float32(0.5 * (bird.top - bird.bottom))
        half = np.float32(0.5 * bird.cells * bird.cell_size)
        self._geometry = bird.cells, half, np.float32(1 / bird.cell_size), np.float32(bird.bottom), np.float32(bird.top)
        self._image = np.zeros((SCAN_CHANNELS + PAST_CHANNELS * len(residual.lags), bird.cells**2), np.float32)
        self._nearest = np.empty(bird.cells**2, np.float32)
        self._first = np.empty(bird.cells**2, np.int32)

    def project(self, scan: Entered, past: Sequence[Past | None]) -> Projected:
        """See `Inputs`."""
        pixel, distance = np.empty(len(scan), np.int32), np.empty(len(scan), np.float32)
        befores = self._befores(past)

        def project_one(task: int) -> None:
            if task == 0:
                grids = self._first, self._nearest, self._image[1], self._image[2]
                look_down(scan.points, scan.takes_part, self._geometry, pixel, distance, *grids)
            elif before := befores[task - 1]:
                transform = np.ascontiguousarray(before.relative[:3], np.float32)
                look_down_on_past(before.points, transform, self._geometry, *self._of_past(task)[:3])

        self.workers.each(project_one, 1 + len(befores))
        return Projected(scan, pixel, distance)

    def residuals(self, projected: Projected, past: Sequence[Past | None]) -> ImageInput:
        """See `Inputs`."""
        points, befores = projected.scan.points, self._befores(past)

        def finish_one(task: int) -> None:
            if task == 0:
                _finish(self._nearest, self._half_height, DENSITY, self._image[:4])
                remission = self._mean[-1], self._std[-1]
                _remission_of_highest(points, self._first, *remission, self._nearest, self._image[4])
            elif befores[task - 1]:
                channels = self._of_past(task)
                _finish(channels[0], self._half_height, DENSITY, channels)
            else:
                self._of_past(task)[:] = 0

        self.workers.each(finish_one, 1 + len(befores))
        square = self._cells, self._cells
        return ImageInput(
            image=self._image.reshape(-1, *square),
            nearest=self._nearest.reshape(square),
            first=self._first.reshape(square),
            pixel=projected.pixel,
            distance=projected.distance,
        )

    def _of_past(self, task: int) -> NDArray[np.float32]:
        """The channels of the past scan that is shown as number `task`, from 1 on."""
        first = SCAN_CHANNELS + PAST_CHANNELS * (task - 1)
        return self._image[first : first + PAST_CHANNELS]

"""The input of the image network: range image and residual images of one scan and the scans before it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.residual import Residual
from runtime.compute.jit import fast_kernel
from runtime.compute.workers import Workers
from runtime.image.projection import nearest_range, pixel_scale, project_scan
from runtime.sensors.range_image import RangeImage


@dataclass(frozen=True)
class ImageInput:
    """What `InputBuilder.build` returns. `image`, `range_image` and `first` are buffers that the next call reuses."""

    image: NDArray[np.float32]  # (5 + lags, H, W) range, x, y, z, remission normalised; residual images
    range_image: NDArray[np.float32]  # (H, W) m, range of the nearest point; 0 where the pixel is empty
    first: NDArray[np.int32]  # (H, W) index of the nearest point; -1 where the pixel is empty
    pixel: NDArray[np.int32]  # (N,) v * W + u of every point; -1: none (at the origin or not finite)
    range: NDArray[np.float32]  # (N,) m; 0 where pixel is -1


@fast_kernel
def _fill_channels(points, first, nearest, mean, std, channels):  # type: ignore[no-untyped-def]
    """Write the five normalised channels (5, H * W); replace infinity in `nearest` by 0."""
    for cell in range(first.shape[0]):
        i = first[cell]
        if i < 0:
            nearest[cell] = np.float32(0)
            for c in range(5):
                channels[c, cell] = np.float32(0)
        else:
            channels[0, cell] = (nearest[cell] - mean[0]) / std[0]
            for c in range(4):
                channels[c + 1, cell] = (points[i, c] - mean[c + 1]) / std[c + 1]


@fast_kernel
def _residual(current, image, signed):  # type: ignore[no-untyped-def]
    """Turn a past range image (H * W) f32 m into the residual image against `current`, in place (paper, eq. 2)."""
    infinity = np.float32(np.inf)
    for cell in range(image.shape[0]):
        now = current[cell]
        past = image[cell]
        both = (now < infinity) & (past < infinity)
        change = (past - now) / now
        change = change if signed else abs(change)
        image[cell] = change if both else np.float32(0)


class InputBuilder:
    """Builds network inputs with buffers that are reused from call to call. Not for concurrent calls."""

    def __init__(self, sensor: RangeImage, residual: Residual, workers: Workers) -> None:
        self.sensor, self.residual, self.workers = sensor, residual, workers
        cells = sensor.height * sensor.width
        self._image = np.zeros((5 + len(residual.lags), cells), np.float32)
        self._nearest = np.empty(cells, np.float32)
        self._limited = np.empty(cells, np.float32)
        self._first = np.empty(cells, np.int32)
        self._mean = np.asarray(sensor.mean, np.float32)
        self._std = np.asarray(sensor.std, np.float32)

    def build(
        self,
        points: NDArray[np.float32],
        past: Sequence[NDArray[np.float32] | None],
        relative: Sequence[NDArray[np.float64] | None],
    ) -> ImageInput:
        """Range image and residual images (paper, Sec. III-A).

        points: (N, 4) f32 x, y, z in m and remission, LiDAR frame.
        past: past[i] is the scan i + 1 steps back, (M, >=3) f32 in its own LiDAR frame, or None where there is none.
        relative: relative[i] = T_current_past, (4, 4) f64, for each of them.
        A lag without a scan gives an image of zeros.
        """
        shape = (self.sensor.height, self.sensor.width)
        scale = pixel_scale(self.sensor)
        limits = np.float32(self.residual.min_range), np.float32(self.residual.max_range)
        pixel = np.empty(len(points), np.int32)
        distance = np.empty(len(points), np.float32)
        lags = [lag if lag <= len(past) and past[lag - 1] is not None else 0 for lag in self.residual.lags]

        def project_one(task: int) -> None:
            if task == 0:
                project_scan(points, scale, *limits, pixel, distance, self._first, self._nearest, self._limited)
            elif lag := lags[task - 1]:
                transform = np.ascontiguousarray(relative[lag - 1][:3], np.float32)  # type: ignore[index]
                nearest_range(past[lag - 1], transform, scale, *limits, self._image[4 + task])

        def finish_one(task: int) -> None:
            if task == 0:
                _fill_channels(points, self._first, self._nearest, self._mean, self._std, self._image)
            elif lags[task - 1]:
                _residual(self._limited, self._image[4 + task], self.residual.kind == "signed")
            else:
                self._image[4 + task] = 0

        self.workers.each(project_one, 1 + len(lags))
        self.workers.each(finish_one, 1 + len(lags))
        return ImageInput(
            image=self._image.reshape(-1, *shape),
            range_image=self._nearest.reshape(shape),
            first=self._first.reshape(shape),
            pixel=pixel,
            range=distance,
        )

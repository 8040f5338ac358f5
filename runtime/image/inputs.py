"""The input of an image network: one scan and the scans before it in its view; here, as range and residual images."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.bundle.residual import Residual
from runtime.compute.jit import fast_kernel, inlined
from runtime.compute.workers import Workers
from runtime.image.entry import Entered, Entry
from runtime.image.history import History, Past
from runtime.image.projection import nearest_range, pixel_scale, project_scan
from runtime.sensors.range_image import RangeImage
from runtime.sensors.sensor import UNKNOWN_REACH

IDENTITY = np.eye(4, dtype=np.float32)[:3]


@dataclass(frozen=True)
class Projected:
    """The pixel of every point of a scan."""

    scan: Entered
    pixel: NDArray[np.int32]  # (N,) v * W + u; -1: takes no part, or is out of the view
    distance: NDArray[np.float32]  # (N,) m, its range; seen from above, its depth below the top. 0 where pixel is -1


@dataclass(frozen=True)
class ImageInput:
    """What `Inputs.build` returns. `image`, `nearest` and `first` are buffers that the next call reuses."""

    image: NDArray[np.float32]  # of the view's shape (channels, H, W): the current scan in the first 5, then the past
    nearest: NDArray[np.float32]  # (H, W) m, distance of the nearest point; 0 where the pixel is empty
    first: NDArray[np.int32]  # (H, W) index of the nearest point; -1 where the pixel is empty
    pixel: NDArray[np.int32]  # (N,) as in `Projected`
    distance: NDArray[np.float32]  # (N,)


class Inputs(ABC):
    """Makes network inputs with buffers that are reused from call to call. Not for concurrent calls.

    The one way from scans to the network's input: of the runner, of training, calibration, parity and benchmarks.
    `runtime.image.making.make_inputs` knows the kind for each view.
    """

    def __init__(
        self,
        range_image: RangeImage,
        residual: Residual,
        workers: Workers,
        reach: float = UNKNOWN_REACH,
        nearest: float = 0.0,
        body: Sequence[float] | None = None,
        mounting: NDArray[np.float64] | None = None,
    ) -> None:
        """reach: m, of the sensor; farther points take no part, nor do those of the carrier: see `Entry`."""
        self.workers, self._lags, self._sensor_image = workers, residual.lags, range_image
        self._entry = Entry(range_image.mean[4], reach, workers, nearest, body, mounting)
        self._mean = np.asarray(range_image.mean, np.float32)
        self._std = np.asarray(range_image.std, np.float32)

    def enter(self, scan: ArrayLike) -> Entered:
        """Take in a scan, see `Entry.enter`."""
        return self._entry.enter(scan)

    def build(self, scan: Entered, past: Sequence[Past | None]) -> ImageInput:
        """The network's input for a scan (paper, Sec. III-A).

        past: past[i] is the scan i + 1 steps back, or None where there is none: channels of zeros.
        """
        return self.residuals(self.project(scan, past), past)

    @abstractmethod
    def project(self, scan: Entered, past: Sequence[Past | None]) -> Projected:
        """Every point to its pixel: those of the scan, and those of past scans as seen from it now."""

    @abstractmethod
    def residuals(self, projected: Projected, past: Sequence[Past | None]) -> ImageInput:
        """The channels of the scan and those of its past."""

    def range_image(self, scan: Entered) -> NDArray[np.float32]:
        """(H, W) m, range of the nearest point of each pixel of the sensor, 0 where it is empty.

        scan: the one whose input was built last.
        """
        image = self._sensor_image
        nearest = np.empty(image.height * image.width, np.float32)
        limits = np.float32(0), np.float32(np.inf)
        nearest_range(scan.points[scan.takes_part], IDENTITY, pixel_scale(image), *limits, nearest)
        nearest[np.isinf(nearest)] = 0
        return nearest.reshape(image.height, image.width)

    def image_of(self, drive: Sequence[tuple[ArrayLike, NDArray[np.float64]]]) -> tuple[Entered, ImageInput]:
        """The last scan of a drive, each with its pose T_world_lidar, and the input that a runner makes of it."""
        *before, (scan, pose) = drive
        history = History()
        for earlier, its_pose in before:
            history.add(self.enter(earlier), its_pose, None)
        entered = self.enter(scan)
        return entered, self.build(entered, history.past(pose))

    def _befores(self, past: Sequence[Past | None]) -> list[Past | None]:
        """The past scan of each lag."""
        return [past[lag - 1] if lag <= len(past) else None for lag in self._lags]


@inlined
def normalised_remission(remission, mean, std):  # type: ignore[no-untyped-def]
    """It counts as 0..1 at most: by the mean of a channel a single wild one would change labels everywhere."""
    return (min(max(remission, np.float32(0)), np.float32(1)) - mean) / std


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
            for c in range(3):
                channels[c + 1, cell] = (points[i, c] - mean[c + 1]) / std[c + 1]
            channels[4, cell] = normalised_remission(points[i, 3], mean[4], std[4])


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


class InputBuilder(Inputs):
    """Range image and residual images."""

    def __init__(self, range_image: RangeImage, residual: Residual, workers: Workers, *entry: Any) -> None:
        """entry: reach and more, as of `Inputs`."""
        super().__init__(range_image, residual, workers, *entry)
        self._shape, self._signed = (range_image.height, range_image.width), residual.kind == "signed"
        self._scale = pixel_scale(range_image)
        self._limits = np.float32(residual.min_range), np.float32(residual.max_range)
        cells = range_image.height * range_image.width
        self._image = np.zeros((5 + len(residual.lags), cells), np.float32)
        self._nearest = np.empty(cells, np.float32)
        self._limited = np.empty(cells, np.float32)
        self._first = np.empty(cells, np.int32)

    def project(self, scan: Entered, past: Sequence[Past | None]) -> Projected:
        """See `Inputs` (paper, eq. 1)."""
        pixel = np.empty(len(scan), np.int32)
        distance = np.empty(len(scan), np.float32)
        befores = self._befores(past)

        def project_one(task: int) -> None:
            if task == 0:
                images = self._first, self._nearest, self._limited
                project_scan(scan.points, scan.takes_part, self._scale, *self._limits, pixel, distance, *images)
            elif before := befores[task - 1]:
                transform = np.ascontiguousarray(before.relative[:3], np.float32)
                nearest_range(before.points, transform, self._scale, *self._limits, self._image[4 + task])

        self.workers.each(project_one, 1 + len(befores))
        return Projected(scan, pixel, distance)

    def residuals(self, projected: Projected, past: Sequence[Past | None]) -> ImageInput:
        """The five normalised channels, and how ranges changed since each past scan (paper, eq. 2)."""
        points = projected.scan.points
        befores = self._befores(past)

        def finish_one(task: int) -> None:
            if task == 0:
                _fill_channels(points, self._first, self._nearest, self._mean, self._std, self._image)
            elif befores[task - 1]:
                _residual(self._limited, self._image[4 + task], self._signed)
            else:
                self._image[4 + task] = 0

        self.workers.each(finish_one, 1 + len(befores))
        return ImageInput(
            image=self._image.reshape(-1, *self._shape),
            nearest=self._nearest.reshape(self._shape),
            first=self._first.reshape(self._shape),
            pixel=projected.pixel,
            distance=projected.distance,
        )

    def range_image(self, scan: Entered) -> NDArray[np.float32]:
        """See `Inputs`."""
        return self._nearest.reshape(self._shape)

"""Training samples: network inputs and labels, made by the runtime's own kernels.

A source makes *groups* of samples; a group is a pure function of the source and its number, so that any
process may make it, in any order, and training can go on from anywhere.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mos_model.data.augment import NONE, Augmentation, augment
from runtime.bundle.residual import HISTORY, Residual
from runtime.bundle.view import BirdView, CylinderView, View
from runtime.classes import CLASSES, MOVING, UNLABELLED, to_classes
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.image.entry import Entry
from runtime.image.history import Past
from runtime.image.making import make_inputs
from runtime.recordings.poses import relative_pose
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import DEFAULT_SENSOR, find_sensor
from runtime.sensors.sensor import Sensor

if TYPE_CHECKING:  # it needs torch, which makes a worker process slow to start
    from mos_model.networks.config import ModelConfig

VALIDATION_STREETS = 10_000_000  # seeds from here on are held out


class Frame(NamedTuple):
    """One scan with labels."""

    points: NDArray[np.float32]  # (N, 4) m and remission, LiDAR frame; all take part
    pose: NDArray[np.float64]  # (4, 4) T_world_lidar
    classes: NDArray[np.uint8]  # (N,) 0 unlabelled, 1 static, 2 moving


class Sample(NamedTuple):
    """What the network sees of one frame, and what it should say."""

    image: NDArray[np.float32]  # of the view's shape (channels, H, W)
    labels: NDArray[np.uint8]  # (H, W) class of the nearest point of each pixel; 0 also where it is empty
    xyz: NDArray[np.float32]  # (N, 3) m; (0, 3) unless the points were asked for
    pixel: NDArray[np.int32]  # (N,) v * W + u, of points that have one
    classes: NDArray[np.uint8]  # (N,)


class Source(Protocol):
    """Where samples come from. Picklable: worker processes get a copy."""

    @property
    def group_size(self) -> int:
        """Samples of every group."""

    def group(self, number: int) -> list[Sample]:
        """The samples of group `number` = 0, 1, ..."""


@dataclass(frozen=True)
class SampleConfig:
    """How a frame becomes a sample."""

    sensor: str | Sensor = DEFAULT_SENSOR  # or its name: what is simulated, and how far returns reach
    other_sensors: tuple[str, ...] = ()  # that the network is for too, by their names
    range_image: RangeImage = field(default_factory=RangeImage)
    residual: Residual = field(default_factory=Residual)
    augmentation: Augmentation = NONE
    crop: int = 0  # columns of the part of the image that is kept; 0: all
    crop_on_moving: float = 0.0  # share of the crops that hold a mover, if the image has one
    points: bool = False  # give the points too (for the point head), those of the crop
    bird: BirdView | None = None  # the network looks from above
    cylinder: CylinderView | None = None  # the network sees points in a cylinder, whose sectors are the columns

    def __post_init__(self) -> None:
        width = self.view.shape[2]
        if self.crop and (self.crop % 16 or not 16 <= self.crop <= width):
            raise SettingError(f"crop must be a multiple of 16 up to the width of the view, {width}, not {self.crop}")

    @classmethod
    def of(cls, model: "ModelConfig", **others: Any) -> "SampleConfig":
        """As a network sees its sensor; `others` are fields of this class."""
        view = model.view
        others |= {"bird": view.bird, "cylinder": view.cylinder}
        return cls(model.sensor, model.other_sensors, view.range_image, view.residual, **others)

    @property
    def view(self) -> View:
        """What the network is shown."""
        return View(self.range_image, self.residual, self.bird, self.cylinder)

    @property
    def reach(self) -> float:
        """m; farther returns take no part."""
        return find_sensor(self.sensor).reach


def make_frame(scan: ArrayLike, pose: NDArray[np.float64], classes: NDArray[np.uint8], config: SampleConfig) -> Frame:
    """A frame of the points that take part, as a runner takes them in. See `runtime.image.entry`."""
    entered = Entry(config.range_image.mean[4], config.reach, Workers(1)).enter(scan)
    if entered.takes_part.all():
        return Frame(entered.points, pose, classes)
    return Frame(entered.points[entered.takes_part], pose, classes[entered.takes_part])


def make_samples(
    frames: Sequence[Frame | None], config: SampleConfig, rng: np.random.Generator, crops: int = 1
) -> list[Sample]:
    """Samples of the last of `frames`; the others are the scans before it (None: missing), the oldest first.

    The crops of one frame come from the same augmented image.
    """
    current = frames[-1]
    if current is None:
        raise SettingError("the last frame of a sample must not be missing")
    past = list(reversed(frames[:-1]))
    relative = [None if frame is None else relative_pose(current.pose, frame.pose) for frame in past]
    scans = [None if frame is None else frame.points for frame in past]
    made = augment(current.points, current.classes, scans, relative, config.augmentation, rng)
    inputs = make_inputs(config.view, Workers(1), config.reach)
    befores = [
        None if points is None or pose is None else Past(points, pose)
        for points, pose in zip(made.past, made.relative, strict=True)
    ]
    entered = inputs.enter(made.points)
    built = inputs.build(entered, befores)
    labels = np.where(built.first < 0, np.uint8(UNLABELLED), made.labels[built.first])
    whole = Sample(built.image, labels, _NOWHERE, _NO_PIXEL, _NO_CLASS)
    if config.points:
        seen = built.pixel >= 0  # some have left the reach of the sensor, or are out of the view
        whole = Sample(built.image, labels, made.points[seen, :3], built.pixel[seen], made.labels[seen])
    if not config.crop:
        return [whole]
    return [_cropped(whole, _draw_columns(whole, config, rng), config.view) for _ in range(crops)]


_NOWHERE, _NO_PIXEL, _NO_CLASS = np.empty((0, 3), np.float32), np.empty(0, np.int32), np.empty(0, np.uint8)


def _cropped(sample: Sample, columns: NDArray[np.int64], view: View) -> Sample:
    """The part of a sample in some neighbouring columns of its view."""
    kept = columns if view.cylinder is None else np.flatnonzero(np.isin(_column(sample, view), columns))
    width = sample.labels.shape[1]
    place = np.full(width, -1)
    place[kept] = np.arange(len(kept))
    column = place[sample.pixel % width]
    inside = column >= 0
    pixel = (sample.pixel // width * len(kept) + column)[inside].astype(np.int32)
    points = sample.xyz[inside], pixel, sample.classes[inside]
    return Sample(np.ascontiguousarray(sample.image[:, :, kept]), sample.labels[:, kept], *points)


def _column(sample: Sample, view: View) -> NDArray[np.int64]:
    """In which column of its view each column of an image lies: of points their sector, -1 without one."""
    if view.cylinder is None:
        return np.arange(sample.labels.shape[1])
    cell = sample.image[-1, 0].astype(np.int64)
    return np.where(cell < 0, -1, cell // view.cylinder.layers % view.cylinder.sectors)


def _draw_columns(sample: Sample, config: SampleConfig, rng: np.random.Generator) -> NDArray[np.int64]:
    """Columns of a crop; it may reach over the seam of the view, if there is one."""
    width = config.view.shape[2]
    start = int(rng.integers(width))
    with_mover = np.unique(_column(sample, config.view)[(sample.labels == MOVING).any(axis=0)])
    if rng.random() < config.crop_on_moving and len(with_mover):
        groups = np.split(
            with_mover, np.flatnonzero(np.diff(with_mover) > 1) + 1
        )  # a mover far away counts as a near one
        start = int(rng.choice(groups[rng.integers(len(groups))])) - int(rng.integers(config.crop))
    if not config.view.closed:
        start = min(max(start, 0), width - config.crop)
    columns: NDArray[np.int64] = np.arange(start, start + config.crop) % width
    return columns


@dataclass(frozen=True)
class SimulatedStreets:
    """Endless simulated streets; a group is one street."""

    samples: SampleConfig
    seed: int = 0
    frames: int = 8  # scans of a street that become samples
    every: int = 2  # scans between them
    crops: int = 1  # of each of them
    first_street: int | None = None  # streets are numbered from here instead of by the seed (validation)
    street: Mapping[str, Any] = field(default_factory=dict)  # settings of the simulation that are not drawn

    @property
    def group_size(self) -> int:
        """Samples of a street."""
        return self.frames * (self.crops if self.samples.crop else 1)

    def group(self, number: int) -> list[Sample]:
        """Simulate a street and make samples of some of its scans, all with a full history."""
        from mos_model.simulator import simulate

        street = (self.seed * 100_003 + number) % VALIDATION_STREETS
        if self.first_street is not None:
            street = self.first_street + number
        rng = np.random.default_rng((self.seed, number))
        history: deque[Frame] = deque(maxlen=HISTORY + 1)
        samples: list[Sample] = []
        length = HISTORY + 1 + self.every * (self.frames - 1)
        for index, scan in enumerate(simulate(street, length, sensor=self.samples.sensor, **self.street)):
            history.append(make_frame(scan.points, scan.pose, to_classes(scan.labels), self.samples))
            if index >= HISTORY and (index - HISTORY) % self.every == 0:
                samples += make_samples(list(history), self.samples, rng, self.crops)
        return samples


def class_frequency(source: Source, samples: int) -> NDArray[np.float64]:
    """Share (3,) of each class in the first `samples` samples of a source, rounded up to whole groups.

    Of points, where the samples have them, or else of pixels (empty ones count as unlabelled).
    """
    counts = np.zeros(len(CLASSES), np.int64)
    for number in range(-(-samples // source.group_size)):
        for sample in source.group(number):
            labels = sample.classes if len(sample.classes) else sample.labels
            counts += np.bincount(labels.reshape(-1), minlength=len(CLASSES))
    shares: NDArray[np.float64] = counts / max(1, counts.sum())
    return shares

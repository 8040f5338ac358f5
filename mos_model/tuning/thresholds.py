"""From which probability on a pixel, and a point of the point head, counts as moving: found on simulated drives.

Drives that neither training nor validation saw, and light traffic, as on most streets: training streets have more
movers than life, and a threshold chosen on them would raise false alarms.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from mos_model.data.dataset import Sample, SampleConfig, SimulatedStreets
from mos_model.networks.checkpoint import Checkpoint, load
from mos_model.tuning.histogram import Histogram
from runtime.bundle.manifest import Tuned
from runtime.classes import MOVING
from runtime.sensors.registry import find_sensor

Probabilities = NDArray[np.float32]

CALIBRATION_STREETS = 15_000_000  # seeds from here on choose thresholds; validation has those below
LIGHT_TRAFFIC = 0.35  # of the usual density
AROUND = 0.8  # m, which is beyond the halo of the runtime
ALIKE = (20, 40, 80, 1000)  # beams up to which sensors share their thresholds


@dataclass(frozen=True)
class Found:
    """Thresholds of some sensors, by their names, and the IoU that they gave on the calibration streets."""

    sensors: tuple[str, ...]
    threshold: float
    iou: float
    head_threshold: float | None
    head_iou: float | None

    @property
    def decision(self) -> dict[str, float | None]:
        """What a checkpoint says of each of the sensors."""
        return {"threshold": self.threshold, "head_threshold": self.head_threshold}


def sensor_classes(own: str, others: Sequence[str]) -> list[tuple[str, ...]]:
    """The network's own sensor by itself; the others with those that have about as many beams."""
    classes: dict[int, list[str]] = {}
    for name in others:
        beams = find_sensor(name).beams
        classes.setdefault(next(most for most in ALIKE if beams <= most), []).append(name)
    return [(own,), *(tuple(names) for _, names in sorted(classes.items()))]


def has_few_beams(sensors: Sequence[str]) -> bool:
    """Whether all of them belong to those of the fewest beams."""
    return all(find_sensor(name).beams <= ALIKE[0] for name in sensors)


def find_thresholds(checkpoint: Path, sensors: tuple[str, ...], streets: int, candidate: float) -> Found:
    """The thresholds of highest IoU on streets with and without movers, for some sensors of a network."""
    torch.set_num_threads(1)
    found = load(checkpoint)
    pixels, points = calibrate(found, streets, candidate, sensors=sensors)
    of_head = points.best_threshold() if found.point_head is not None else (None, None)
    return Found(sensors, *pixels.best_threshold(), *of_head)


def calibrate(
    found: Checkpoint,
    streets: int,
    candidate: float = Tuned.candidate,
    frames: int = 2,
    sensors: Sequence[str] | None = None,
) -> tuple[Histogram, Histogram]:
    """Histograms of pixels and of points over `streets` calibration streets with light traffic, and five times as many
    without a mover.

    sensors: take turns; None: the network's own. Where there are others too, every second street is of the wide variety
    that they learnt from.
    """
    names = list(sensors or [found.config.sensor])
    return histograms(found, _calibration_samples(found, streets, frames, names), candidate)


def _calibration_samples(found: Checkpoint, streets: int, frames: int, names: Sequence[str]) -> Iterator[Sample]:
    for first, count, settings in (
        (CALIBRATION_STREETS, streets, {"movers": LIGHT_TRAFFIC}),
        (CALIBRATION_STREETS + 10_000, 5 * streets, {"movers": 0.0}),
    ):  # false alarms come in clumps: in few streets, many
        for number in range(count):
            wide: dict[str, Any] = {"version": 2} if found.config.other_sensors and number % 2 else {}
            samples = samples_of(found, names[number % len(names)])
            few = frames if settings["movers"] else 1
            drives = SimulatedStreets(samples, frames=few, every=4, first_street=first, street={**settings, **wide})
            yield from drives.group(number)


def histograms(
    found: Checkpoint, samples: Iterable[Sample], candidate: float = Tuned.candidate
) -> tuple[Histogram, Histogram]:
    """Histograms of the pixels and of the points of some samples, which have both."""
    pixels, points = Histogram(), Histogram()
    for sample in samples:
        image, refined = probabilities(found, sample, candidate)
        pixels.add(image, sample.labels)
        points.add(refined, sample.classes)
    return pixels, points


def samples_of(found: Checkpoint, sensor: str) -> SampleConfig:
    """How a network sees one of its sensors."""
    samples = SampleConfig.of(found.config, points=True)
    if sensor == found.config.sensor:
        return samples
    return replace(samples, sensor=sensor, range_image=find_sensor(sensor).range_image)


@torch.no_grad()
def probabilities(found: Checkpoint, sample: Sample, candidate: float) -> tuple[Probabilities, Probabilities]:
    """Probability of moving of the pixels (H, W), and of the points (N,): those of a candidate by the point head, which
    looks around them as in the runtime; of others their pixel's."""
    output = found.image_net(torch.from_numpy(sample.image[None]))
    image = output.logits[0].softmax(0)[MOVING]  # (H, W)
    pixel = torch.from_numpy(sample.pixel).long()
    points = image.flatten()[pixel]  # (N,)
    looked_at = torch.from_numpy(around(sample.xyz, points.numpy() > candidate))
    if found.point_head is not None and looked_at.any():
        grid = found.point_head.grid(torch.from_numpy(sample.xyz)[looked_at])
        refined = found.point_head(grid, output.features_at(0, pixel[looked_at])).softmax(1)[:, MOVING]
        before = points[looked_at]
        points[looked_at] = torch.where(before > candidate, refined, before)
    return image.numpy(), points.numpy()


def around(xyz: NDArray[np.float32], candidates: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) whether a point is in a cube of AROUND that has a candidate or touches one: what the point head looks at."""
    cube = np.floor(xyz / AROUND).astype(np.int64)
    steps = np.array((1, 1 << 20, 1 << 40))
    neighbours = np.stack(np.meshgrid(*3 * [(-1, 0, 1)]), -1).reshape(-1, 3) @ steps
    wanted = np.unique((cube[candidates] @ steps)[:, None] + neighbours)
    inside: NDArray[np.bool_] = np.isin(cube @ steps, wanted)
    return inside

"""Which sensor a bundle is run for: the one that is given, its only one, or the one that a scan shows."""

import logging
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.bundle.manifest import Manifest, SensorEntry
from runtime.sensors.finding import Found, find_from_scan
from runtime.sensors.mounting import Pose
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import SENSORS
from runtime.sensors.sensor import Sensor

log = logging.getLogger("lidar_mos.sensors")  # `mos` says what it is told


@dataclass(frozen=True)
class Choice:
    """A sensor, with the range image and the thresholds that a network takes for it."""

    entry: SensorEntry
    text: str  # how it was chosen, in words
    mounting: Pose | None = None  # (4, 4) T_sensor_scan, where scans are not in the sensor's own frame


def choose_before(manifest: Manifest, given: Sensor | None) -> Choice | None:
    """The sensor that is given, or the only one of a bundle; None: the first scan is to decide."""
    if given is not None:
        return _choice(manifest, given, f"{given.name}, as given")
    if len(manifest.sensors) == 1:
        return Choice(manifest.sensor, f"{manifest.sensor.name}, the one that the bundle is for")
    return None


def choose_from(manifest: Manifest, found: Found) -> Choice:
    """The sensor that was found in a scan."""
    return replace(_choice(manifest, found.sensor, found.text), mounting=found.mounting)


class Chooser:
    """Decides on the sensor, once."""

    def __init__(self, manifest: Manifest, given: Sensor | None) -> None:
        self._manifest, self._before = manifest, choose_before(manifest, given)
        self.default = self._before or Choice(manifest.sensor, "")  # for scans that show none
        self.chosen = self._before  # None until a scan decides

    @property
    def sensor(self) -> SensorEntry | None:
        """The chosen one."""
        return self.chosen.entry if self.chosen else None

    def forget(self) -> None:
        """The next scan decides, where it is to."""
        self.chosen = self._before

    def propose(self, scan: NDArray[np.floating], ring: ArrayLike | None = None) -> Choice:
        """The sensor for a scan: the chosen one, else that which it shows."""
        if self.chosen is not None:
            return self.chosen
        found = find_from_scan(scan, ring)
        return choose_from(self._manifest, found) if found else self.default

    def keep(self, choice: Choice) -> None:
        """What was proposed is in use; it stays if a scan showed it."""
        if self.chosen is None and choice is not self.default:
            self.chosen = choice
            log.info("%s", choice.text)


def _choice(manifest: Manifest, sensor: Sensor, text: str) -> Choice:
    """What the bundle has for a sensor; else its own range image, with the thresholds of the nearest."""
    entry = next((one for one in manifest.sensors if one.name == sensor.name), None)
    if entry is not None and sensor == SENSORS.get(sensor.name):
        return Choice(entry, text)
    image = sensor.range_image
    near = entry or min(manifest.sensors, key=lambda one: _unlike(one.range_image, image))
    image = replace(image, mean=near.range_image.mean, std=near.range_image.std)
    text += "" if entry else f", by the thresholds for {near.name}"
    return Choice(SensorEntry(sensor.name, image, sensor.reach, near.decision), text)


def _unlike(one: RangeImage, other: RangeImage) -> float:
    """How far two range images are from each other, in rows and field of view."""
    ends = abs(one.fov_up - other.fov_up) + abs(one.fov_down - other.fov_down)
    return abs(math.log(one.height / other.height)) + ends / 30

"""A spinning LiDAR: its beams, its timing, its noise, and the range image that its turns fill."""

from dataclasses import dataclass, replace
from itertools import pairwise

from runtime.errors import SettingError
from runtime.sensors.range_image import RangeImage

EVEN = 0.02  # share by which the angles between beams may differ where rows lie at equal angles
FARTHEST = 1e4  # m, that any sensor reaches
UNKNOWN_REACH = 300.0  # m, of a sensor of which nothing is known: farther returns make no sense on a road


@dataclass(frozen=True)
class Sensor:
    """One sensor model. Angles in degrees, lengths in m. Row 0 is the highest beam; azimuth 0 is forward and grows to
    the left."""

    name: str
    elevations: tuple[float, ...]  # degrees, from the highest beam down
    azimuth_steps: int  # firings in one turn
    encoder_steps: int = 0  # positions that the encoder tells apart in one turn (0: every firing its own)
    rate: float = 10.0  # Hz, turns per second
    spin_tolerance: float = 0.0  # share by which the motor may turn slower or faster, firings coming at their own pace
    min_range: float = 0.9  # m
    max_range: float = 80.0  # m, the simulated sensor reports nothing beyond
    reach: float = UNKNOWN_REACH  # m, a real one can return nothing from beyond: such points take no part
    mount_height: float = 1.73  # m above the road
    range_noise: float = 0.010  # m, standard deviation of one return
    beam_bias: float = 0.006  # m, standard deviation of the constant range error of a beam
    sensitivity: float = 3.0e-6  # albedo * cos(incidence) / range^2 that is detected half of the time
    dropout: float = 0.004  # share of firings that fail for no visible reason
    lifts: tuple[float, ...] = (0.0,)  # m, height of the optics above the sensor's origin, by block of beams
    remission_step: float = 0.01  # quantisation of remission
    self_hidden: bool = False  # the roof of the car hides parts of the lowest beams
    image: RangeImage | None = None  # None: a row for each beam

    def __post_init__(self) -> None:
        if len(self.elevations) < 2 or not all(above > below for above, below in pairwise(self.elevations)):
            raise SettingError(f"sensor {self.name!r}: elevations must fall from the highest beam to the lowest")
        if not (self.azimuth_steps > 0 and self.rate > 0 and 0 <= self.min_range < self.max_range <= self.reach):
            raise SettingError(f"sensor {self.name!r}: azimuth steps, rate and range limits must be positive and rise")
        if not self.lifts or self.beams % len(self.lifts):
            raise SettingError(f"sensor {self.name!r}: its {self.beams} beams are no {len(self.lifts)} equal blocks")

    @property
    def beams(self) -> int:
        """Number of rows."""
        return len(self.elevations)

    @property
    def range_image(self) -> RangeImage:
        """The range image of the sensor; normalised as the published HDL-64E networks."""
        if self.image is not None:
            return self.image
        width = min(2048, max(16, self.azimuth_steps // 16 * 16))
        gaps = [a - b for a, b in pairwise(self.elevations)]
        spare = -self.beams % 16  # rows without a beam, below the last
        up, down = self.elevations[0] + gaps[0] / 2, self.elevations[-1] - gaps[-1] / 2
        if max(gaps) - min(gaps) < EVEN * max(gaps) and down - gaps[-1] * spare >= -90 and up <= 90:
            return RangeImage(self.beams + spare, width, up, down - gaps[-1] * spare)
        return RangeImage(self.beams + spare, width, min(up, 90), max(down, -90), elevations=self.elevations)

    def spinning(self, speed: float) -> "Sensor":
        """The same sensor with a motor of `speed` times the nominal rate: fewer firings fit into a faster turn."""
        return replace(self, rate=self.rate * speed, azimuth_steps=round(self.azimuth_steps / speed))


def even(top: float, bottom: float, count: int) -> tuple[float, ...]:
    """Elevations in degrees of `count` beams at equal angles."""
    return tuple(top + (bottom - top) * i / (count - 1) for i in range(count))

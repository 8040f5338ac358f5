"""Simulated drives of many sensors: what one set of weights that runs on all of them learns from."""

from dataclasses import dataclass, field, replace
from random import Random
from typing import Any

from mos_model.data.dataset import Sample, SampleConfig, SimulatedStreets
from runtime.sensors.registry import SENSORS
from runtime.sensors.sensor import Sensor, even

RATES = ((10.0, 70), (20.0, 15), (5.0, 15))  # Hz, and of how many drives in a hundred
OWN_SHARE = 0.18  # of the drives are of the network's own sensor
FEW_SHARE = 0.35  # are of sensors of few beams, which are the hardest to learn
FEW = 20  # beams, at most
THINNED, UNKNOWN = 0.12, 0.1  # with some of the beams of a sensor, with beams of no sensor that we know
WIDEST = 800  # columns of a crop
BEAMS = (16, 20, 24, 32, 40, 48, 64, 80, 96, 128)  # of unknown sensors


@dataclass(frozen=True)
class MixedDrives:
    """Endless drives, each of a sensor, mounting, rate and place that are drawn for it; a group is one drive.

    All samples of a drive have images of one shape, those of several drives do not.
    """

    samples: SampleConfig  # of the network's own sensor; what is cropped there is as many pixels elsewhere
    seed: int = 0
    frames: int = 8  # scans of a drive that become samples
    every: int = 2  # scans between them
    crops: int = 1  # of each of them
    first_street: int | None = None  # as in `SimulatedStreets`
    settings: dict[str, Any] = field(default_factory=lambda: {"version": 2})  # of the simulation

    @property
    def group_size(self) -> int:
        """Samples of a drive."""
        return self.frames * (self.crops if self.samples.crop else 1)

    def group(self, number: int) -> list[Sample]:
        """Simulate a drive and make samples of some of its scans, all with a full history."""
        rng = Random(f"sensor {self.first_street or self.seed} {number}")
        sensor = draw_sensor(rng, str(self.samples.sensor))
        rate = rng.choices(*zip(*RATES, strict=True))[0] if "rate" not in self.settings else self.settings["rate"]
        turning = sensor.spinning(rate / sensor.rate)
        image = (sensor if rng.random() < 0.3 else turning).range_image  # made for another rate, or for this one
        own, (_, height, width) = self.samples.view, replace(self.samples, range_image=image, crop=0).view.shape
        crop = self.samples.crop and min(self.samples.crop * own.shape[1] // height, WIDEST, width) // 16 * 16
        streets = SimulatedStreets(
            replace(self.samples, sensor=sensor, range_image=image, crop=crop),
            self.seed,
            self.frames,
            self.every,
            self.crops,
            self.first_street,
            {**self.settings, "rate": rate},
        )
        return streets.group(number)


def draw_sensor(rng: Random, own: str) -> Sensor:
    """The network's own sensor, by its name, another one, one with fewer beams, or one that nobody knows."""
    which = rng.random()
    if which < OWN_SHARE:
        return SENSORS[own]
    if which < OWN_SHARE + FEW_SHARE:
        return few(rng)
    sensor = SENSORS[rng.choice(sorted(SENSORS))]
    kind = rng.random()
    if kind < THINNED and sensor.beams >= 32:
        step = rng.choice((2, 4) if sensor.beams >= 64 else (2,))
        return thinned(sensor, step, rng.randrange(step))
    return unknown(rng, sensor) if kind > 1 - UNKNOWN else sensor


def few(rng: Random) -> Sensor:
    """A sensor of few beams, or every second or fourth beam of one of more."""
    if rng.random() < 0.7:
        return SENSORS[rng.choice([name for name in sorted(SENSORS) if SENSORS[name].beams <= FEW])]
    sensor = SENSORS[rng.choice([name for name in sorted(SENSORS) if SENSORS[name].beams in (32, 40, 64)])]
    step = -(-sensor.beams // FEW)
    return thinned(sensor, step, rng.randrange(step))


def thinned(sensor: Sensor, step: int, first: int = 0) -> Sensor:
    """The sensor with every `step`-th of its beams."""
    lifts = tuple(sensor.lifts[i * len(sensor.lifts) // sensor.beams] for i in range(first, sensor.beams, step))
    return replace(
        sensor, name=f"{sensor.name} / {step}", elevations=sensor.elevations[first::step], lifts=lifts, image=None
    )


def unknown(rng: Random, like: Sensor) -> Sensor:
    """A sensor of another number of beams, at angles of its own, in other respects `like` one that there is."""
    beams, view = rng.choice(BEAMS), rng.uniform(20, 60) if rng.random() < 0.8 else rng.uniform(60, 90)
    top = rng.uniform(0.1, 0.6) * view
    regular = even(top, top - view, beams)
    bend = rng.choice((0.0, 0.0, 0.6, 0.9))  # denser about the horizon
    angles = [a - bend * a * max(0.0, 1 - abs(a) / (0.5 * view)) for a in regular]
    steps = rng.choice((900, 1024, 1200, 1800, 1800, 2048, 2048))
    return replace(
        like, name="unknown", elevations=tuple(sorted(set(angles), reverse=True)), azimuth_steps=steps,
        lifts=(0.0,), encoder_steps=0, image=None,
    )  # fmt: skip

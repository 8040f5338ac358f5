"""How the sensor of one sequence is carried: by a car, a van or a robot, level or not, turning fast or slowly."""

import math
from dataclasses import dataclass, replace
from random import Random

from mos_model.simulator.settings import SimulationSettings
from runtime.sensors.sensor import Sensor

ROBOT = 1.5  # m, what carries a sensor lower than this goes at walking pace


@dataclass(frozen=True)
class Mounting:
    """Where the sensor sits; None leaves the profile's usual place, from which the rig varies a little."""

    height: float | None = None  # m above the ground
    pitch: float | None = None  # radians, about the vehicle's y axis: nose down is positive
    roll: float | None = None  # radians, about the vehicle's x axis
    yaw: float = 0.0  # radians, by which the sensor is turned to the left of the way it goes
    rate: float = 1.0  # turns a second, of the profile's
    columns: float = 1.0  # firings in a turn beside those that this rate leaves time for
    pace: float = math.inf  # m/s, of what carries it at most
    noise: float = 1.0  # of the ranges, times the profile's: at some metres sensors err more than at many
    sidewalk: bool = False  # whether that goes beside the road
    ego: str = ""  # how it goes; "": as cars do

    @property
    def robot(self) -> bool:
        """Whether a small robot carries it, not a car."""
        return math.isfinite(self.pace)

    @property
    def size(self) -> tuple[float, float]:
        """Length and width that it needs, m."""
        return (0.8, 0.7) if self.robot else (4.8, 2.0)

    @property
    def body(self) -> tuple[float, float]:
        """Half length and half width of what carries it, m."""
        return (0.4, 0.35) if self.robot else (2.5, 1.2)

    def turning(self, profile: Sensor) -> Sensor:
        """The sensor at its rate: a turn that takes half the time has half the firings."""
        if self.rate == 1.0:
            return profile
        turned = profile.spinning(self.rate)
        return replace(turned, azimuth_steps=round(turned.azimuth_steps * self.columns))


def draw_mounting(seed: int, settings: SimulationSettings, profile: Sensor, indoors: bool = False) -> Mounting:
    """Draw what `settings` leaves open, in version 2 widely, `indoors` low. All is drawn, used or not."""
    rng = Random(f"mount {seed}")
    low, high = rng.choices(
        ((profile.mount_height - 0.3, profile.mount_height + 0.4), (0.35, 0.9), (0.9, 1.5), (2.0, 2.8)),
        (55, 20, 12, 13),
    )[0]
    robot, height = high <= ROBOT, rng.uniform(low, high)
    pitch, roll = math.radians(rng.uniform(-7, 7)), math.radians(rng.uniform(-4, 4))
    tilted, yaw = rng.random() < 0.25, rng.uniform(-math.pi, math.pi) if rng.random() < 0.2 else 0.0
    rate, columns = rng.choices((10.0, 20.0, 5.0), (70, 15, 15))[0], rng.choice((0.5, 1.0))
    pace, sidewalk = rng.uniform(0.3, 1.5), rng.random() < 0.6
    ego = rng.choices(("standing", "slow", "stop_and_go", "turning"), (40, 28, 16, 16))[0]
    noise = rng.choice((1.0, 1.0, 1.6, 2.5))
    if indoors:
        robot, height = True, rng.uniform(0.3, 1.8)
        ego = rng.choices(("standing", "slow", "stop_and_go", "turning"), (55, 22, 12, 11))[0]
    wide = settings.version > 1 and settings.sensor_variation
    if settings.mount_height is not None:
        height, robot = settings.mount_height, indoors or settings.mount_height < ROBOT
    elif not (wide or indoors):
        robot = False
    robot = robot and settings.version > 1
    turns = settings.rate or (rate if wide else profile.rate)
    return Mounting(
        height=height if wide or indoors else settings.mount_height,
        pitch=math.radians(settings.pitch) if settings.pitch is not None else pitch if wide and tilted else None,
        roll=roll if wide and tilted else None,
        yaw=yaw if wide else 0.0,
        rate=turns / profile.rate,
        columns=columns if wide and turns < profile.rate else 1.0,
        pace=pace if robot else math.inf,
        sidewalk=robot and sidewalk,
        noise=noise if indoors else 1.0,
        ego=ego if robot else "",
    )

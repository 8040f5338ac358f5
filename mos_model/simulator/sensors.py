"""Spinning LiDAR sensors: beam pattern, timing, noise. Angles in degrees, lengths in m."""

from dataclasses import dataclass, replace

from runtime.errors import SettingError


@dataclass(frozen=True)
class SensorProfile:
    """One sensor model. Row 0 is the highest beam; azimuth 0 is forward and grows to the left."""

    name: str
    elevations: tuple[float, ...]  # degrees, from the highest beam down
    azimuth_steps: int  # firings in one turn
    encoder_steps: int = 0  # positions that the encoder tells apart in one turn (0: every firing its own)
    rate: float = 10.0  # Hz, turns per second
    spin_tolerance: float = 0.0  # share by which the motor may turn slower or faster, firings coming at their own pace
    min_range: float = 0.9  # m
    max_range: float = 80.0  # m, nothing is reported beyond
    mount_height: float = 1.73  # m above the road
    range_noise: float = 0.010  # m, standard deviation of one return
    beam_bias: float = 0.006  # m, standard deviation of the constant range error of a beam
    sensitivity: float = 3.0e-6  # albedo * cos(incidence) / range^2 that is detected half of the time
    dropout: float = 0.004  # share of firings that fail for no visible reason
    lifts: tuple[float, ...] = (0.0,)  # m, height of the optics above the sensor's origin, by block of beams
    remission_step: float = 0.01  # quantisation of remission
    self_hidden: bool = False  # the roof of the car hides parts of the lowest beams

    def __post_init__(self) -> None:
        if len(self.elevations) < 2 or list(self.elevations) != sorted(set(self.elevations), reverse=True):
            raise SettingError(f"sensor {self.name!r}: elevations must fall from the highest beam to the lowest")
        if not (self.azimuth_steps > 0 and self.rate > 0 and 0 <= self.min_range < self.max_range):
            raise SettingError(f"sensor {self.name!r}: azimuth steps, rate and range limits must be positive")

        if self.beams % len(self.lifts):
            raise SettingError(f"sensor {self.name!r}: its {self.beams} beams are no {len(self.lifts)} equal blocks")

    @property
    def beams(self) -> int:
        """Number of rows."""
        return len(self.elevations)

    def spinning(self, speed: float) -> "SensorProfile":
        """The same sensor with a motor of `speed` times the nominal rate: fewer firings fit into a faster turn."""
        return replace(self, rate=self.rate * speed, azimuth_steps=round(self.azimuth_steps / speed))


def _even(top: float, bottom: float, count: int) -> tuple[float, ...]:
    return tuple(top + (bottom - top) * i / (count - 1) for i in range(count))


def _hdl64e() -> tuple[float, ...]:
    """Two blocks of 32 lasers, 1/3 degree apart from +2 down and 1/2 degree apart from -8.83 down (Velodyne,
    HDL-64E S2 manual)."""
    return tuple([2.0 - i / 3 for i in range(32)] + [-8.83 - i / 2 for i in range(32)])


PROFILES: dict[str, SensorProfile] = {
    profile.name: profile
    for profile in (
        SensorProfile(  # 20,833 firings/s; heights of the blocks as calibrated: ros-drivers/velodyne, 64e_s2.1-sztaki
            "hdl64e", _hdl64e(), 2083, 4000, spin_tolerance=0.04, lifts=(0.203, 0.113), self_hidden=True
        ),
        SensorProfile("hdl32e", _even(10.67, -30.67, 32), 2170, range_noise=0.02, max_range=70.0),
        SensorProfile("vlp16", _even(15.0, -15.0, 16), 1800, range_noise=0.02, max_range=100.0, sensitivity=4e-6),
        SensorProfile("os1-32", _even(21.2, -21.2, 32), 1024, range_noise=0.015, max_range=90.0),
        SensorProfile("os1-64", _even(16.6, -16.6, 64), 1024, range_noise=0.015, max_range=90.0),
        SensorProfile("os1-128", _even(21.2, -21.2, 128), 1024, range_noise=0.015, max_range=90.0),
    )
}


def sensor_profile(sensor: str | SensorProfile) -> SensorProfile:
    """The profile of that name, or the profile itself. Raises SettingError for an unknown name."""
    if isinstance(sensor, SensorProfile):
        return sensor
    if sensor not in PROFILES:
        raise SettingError(f"unknown sensor {sensor!r}; known are {', '.join(PROFILES)}")
    return PROFILES[sensor]

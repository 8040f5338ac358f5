"""What a caller may fix about a simulated sequence; what is left at None or "random" is drawn."""

from dataclasses import dataclass
from random import Random

from runtime.errors import SettingError

STREETS = ("residential", "urban", "highway", "country", "open")
ROOMS = ("room", "corridor", "hall")  # in version 2
INDOORS = 0.12  # share of the sequences of version 2
EGO_MOTIONS = ("standing", "slow", "cruise", "stop_and_go", "pull_away", "turning")
SCAN_MOTIONS = ("off", "on", "compensated")
WEATHERS = ("clear", "fog", "rain", "snow", "dust")
VERSIONS = (1, 2)


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of one sequence."""

    street: str = "random"  # one of STREETS or, in version 2, of ROOMS
    ego: str = "random"  # one of EGO_MOTIONS
    movers: float | None = None  # traffic density: 0 none, 1 usual, 2 dense
    scan_motion: str = "random"  # "off": as if frozen in time; "on": raw sweep; "compensated": with a small error
    pose_noise: float | None = None  # odometry error: 0 none, 1 usual (1.5 cm, 0.06 degrees a frame)
    sensor_variation: bool = True  # mount, beam pattern, noise and self-occlusion vary by sequence
    imperfections: bool = True  # dropouts, mixed pixels, range noise, stray points
    origin_point: bool = False  # one point at the origin ends every scan, as in raw KITTI files
    weather: str = "random"  # one of WEATHERS; what is random is clear in version 1
    body: bool | None = None  # whether the sensor sees what carries it; None: drawn in version 2, not in version 1
    version: int = 1  # 1: cars in streets; 2: more kinds of mounts, people and places
    mount_height: float | None = None  # m above the ground
    pitch: float | None = None  # degrees, nose down
    rate: float | None = None  # Hz, turns a second

    def __post_init__(self) -> None:
        if self.version not in VERSIONS:
            raise SettingError(f"simulation version must be one of {VERSIONS}, not {self.version!r}")
        choices = {"street": (*STREETS, *ROOMS), "ego": EGO_MOTIONS, "scan_motion": SCAN_MOTIONS, "weather": WEATHERS}
        for name, known in choices.items():
            if getattr(self, name) not in (*known, "random"):
                raise SettingError(
                    f"simulation {name} must be 'random' or one of {', '.join(known)}, not {getattr(self, name)!r}"
                )
        if self.street in ROOMS:
            object.__setattr__(self, "version", max(self.version, 2))
        for name in ("movers", "pose_noise"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 10:
                raise SettingError(f"simulation {name} must be None or within 0..10, not {value!r}")
        for name, low, high in (("mount_height", 0.1, 10), ("pitch", -45, 45), ("rate", 1, 100)):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise SettingError(f"simulation {name} must be None or within {low}..{high}, not {value!r}")


@dataclass(frozen=True)
class Conditions:
    """What was drawn, or fixed, for one sequence."""

    street: str
    ego: str
    scan_motion: str
    density: float  # of the traffic, 1 is usual
    pose_noise: float  # strength of the odometry's error, 1 is usual


def draw_room(seed: int, settings: SimulationSettings) -> str:
    """The kind of room that a sequence is in; "" out of doors."""
    rng = Random(f"place {seed}")
    indoors, kind = rng.random() < INDOORS, rng.choices(ROOMS, (60, 15, 25))[0]
    if settings.street == "random":
        return kind if indoors and settings.version > 1 else ""
    return settings.street if settings.street in ROOMS else ""


def draw_conditions(rng: Random, settings: SimulationSettings, room: str = "", usual: str = "") -> Conditions:
    """Draw what `settings` leaves open; `room` where it is indoors; `usual` is how a carrier goes that is no car. All
    is drawn, used or not: fixing one thing leaves the rest alike."""
    street = rng.choices(STREETS, (34, 30, 10, 14, 12))[0]
    ego = rng.choices(EGO_MOTIONS, (22, 13, 35, 8, 9, 13))[0]
    motion = rng.choices(SCAN_MOTIONS, (15, 40, 45))[0]
    density = 0.0 if rng.random() < 0.1 else rng.choice((0.35, 0.7, 1.0, 1.0, 1.6, 2.5))
    noise = 0.0 if rng.random() < 0.08 else min(max(rng.lognormvariate(-0.3, 0.6), 0.15), 3.0)
    return Conditions(
        street=room or (street if settings.street == "random" else settings.street),
        ego=usual or ego if settings.ego == "random" else settings.ego,
        scan_motion=motion if settings.scan_motion == "random" else settings.scan_motion,
        density=density if settings.movers is None else float(settings.movers),
        pose_noise=noise if settings.pose_noise is None else float(settings.pose_noise),
    )

"""What a caller may fix about a simulated sequence; everything left at None or "random" is drawn per sequence."""

from dataclasses import dataclass

from runtime.errors import SettingError

STREETS = ("residential", "urban", "highway", "country", "open")
EGO_MOTIONS = ("standing", "slow", "cruise", "stop_and_go", "pull_away", "turning")
SCAN_MOTIONS = ("off", "on", "compensated")


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of one sequence."""

    street: str = "random"  # one of STREETS
    ego: str = "random"  # one of EGO_MOTIONS
    movers: float | None = None  # traffic density: 0 none, 1 usual, 2 dense
    scan_motion: str = (
        "random"  # "off": as if frozen in time; "on": raw sweep; "compensated": with a small error
    )
    pose_noise: float | None = None  # odometry error: 0 none, 1 usual (1.5 cm, 0.06 degrees a frame)
    sensor_variation: bool = True  # mount, beam pattern, noise and self-occlusion vary by sequence
    imperfections: bool = True  # dropouts, mixed pixels, range noise, stray points
    origin_point: bool = False  # one point at the origin ends every scan, as in raw KITTI files

    def __post_init__(self) -> None:
        for name, known in (("street", STREETS), ("ego", EGO_MOTIONS), ("scan_motion", SCAN_MOTIONS)):
            if getattr(self, name) not in (*known, "random"):
                raise SettingError(
                    f"simulation {name} must be 'random' or one of {', '.join(known)}, not {getattr(self, name)!r}"
                )
        for name in ("movers", "pose_noise"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 10:
                raise SettingError(f"simulation {name} must be None or within 0..10, not {value!r}")

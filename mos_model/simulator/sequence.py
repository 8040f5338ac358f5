"""One simulated drive: `simulate` gives scan after scan, with pose and labels."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from random import Random
from typing import Any

import numpy as np

from mos_model.simulator.carrier import draw_body
from mos_model.simulator.drive import Ride
from mos_model.simulator.indoors import Indoors
from mos_model.simulator.mounting import draw_mounting
from mos_model.simulator.odometry import draw_reported, true_pose
from mos_model.simulator.outdoors import outdoors
from mos_model.simulator.rig import draw_rig
from mos_model.simulator.rooms import Room
from mos_model.simulator.scanner import Scanner
from mos_model.simulator.scene import Scene
from mos_model.simulator.settings import Conditions, SimulationSettings, draw_conditions, draw_room
from mos_model.simulator.traffic import Traffic
from mos_model.simulator.weather import draw_weather
from mos_model.simulator.world import World
from runtime.errors import SettingError
from runtime.sensors.registry import DEFAULT_SENSOR, find_sensor
from runtime.sensors.sensor import Sensor


@dataclass(frozen=True)
class Frame:
    """One scan. Poses are T_world_lidar at the middle of the sweep."""

    points: np.ndarray  # (N, 4) float32: x y z m in the LiDAR frame, remission 0..1
    labels: np.ndarray  # (N,) uint32, SemanticKITTI: class in the lower 16 bits, instance in the upper
    pose: np.ndarray  # (4, 4) float64, as an odometry would report it
    true_pose: np.ndarray  # (4, 4) float64
    time: float  # s


def simulate(seed: int, frames: int, sensor: str | Sensor = DEFAULT_SENSOR, **settings: Any) -> "Simulation":
    """A simulated drive of `frames` scans: iterate over it, or index it. The same arguments give the same
    data.

    `settings` are the fields of `SimulationSettings`. Raises SettingError for settings that cannot be.
    """
    try:
        chosen = SimulationSettings(**settings)
    except TypeError as error:
        raise SettingError(f"unknown simulation setting: {error}") from error
    return Simulation(seed, frames, find_sensor(sensor), chosen)


class Simulation:
    """A drawn street, its traffic, the sensor and its way through it."""

    def __init__(self, seed: int, frames: int, profile: Sensor, settings: SimulationSettings) -> None:
        if not isinstance(frames, int) or frames < 1:
            raise SettingError(f"frames must be a whole number of at least 1, not {frames!r}")
        if not isinstance(seed, int) or seed < 0:
            raise SettingError(f"seed must be a whole number of at least 0, not {seed!r}")
        rng = Random(seed)
        room = draw_room(seed, settings)
        mounting = draw_mounting(seed, settings, profile, bool(room))
        if settings.sensor_variation and profile.spin_tolerance:
            profile = profile.spinning(1 + rng.uniform(-1, 1) * profile.spin_tolerance)
        profile = mounting.turning(profile)
        self.seed, self.profile, self.settings = seed, profile, settings
        self.times = np.arange(frames) / profile.rate
        self.conditions: Conditions = draw_conditions(rng, settings, room, mounting.ego)
        drawn = self.conditions, self.times, mounting
        self.traffic: Traffic | Indoors = (
            Indoors(seed, *drawn) if room else outdoors(seed, rng, *drawn, settings.version)
        )
        self.world: World | Room = self.traffic.world
        drive: Ride = self.traffic.drive
        self.scene = Scene(self.world, self.traffic.tracks)
        rig = draw_body(seed, settings, draw_rig(rng, profile, settings.sensor_variation, mounting))
        self.states = self._sensor_states(drive, rig.mount)
        sky = replace(settings, weather="clear") if room and settings.weather == "random" else settings
        self.weather = draw_weather(seed, sky, profile.beams, self.states[:, 1])
        self.scanner = Scanner(rig, self.weather)
        self.true_poses = [true_pose(state) for state in self.states[:, 1]]
        self.poses = draw_reported(rng, self.true_poses, self.conditions.pose_noise)
        self._misjudged = 1.0 + np.array([rng.gauss(0, 0.03) for _ in range(6)])

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self) -> Iterator[Frame]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, k: int) -> Frame:
        """Scan k."""
        if not 0 <= k < len(self):
            raise IndexError(f"frame {k} of a simulation of {len(self)} frames")
        states, motion = self.states[k], self.conditions.scan_motion
        guess = states[1] + (states - states[1]) * self._misjudged if motion == "compensated" else None
        duration = 0.0 if motion == "off" else 1.0 / self.profile.rate
        seeds = np.random.default_rng((self.seed, k)).integers(1, 2**62, 4).tolist()
        seeds.append(Random(f"weather {self.seed} {k}").getrandbits(62))
        self.scene.move_to(k)
        points, labels = self.scanner.scan(self.scene, states, guess, duration, self.settings.imperfections, seeds)
        if self.settings.origin_point:
            points = np.concatenate([points, np.zeros((1, 4), np.float32)])
            labels = np.concatenate([labels, np.zeros(1, np.uint32)])
        return Frame(points, labels, self.poses[k].copy(), self.true_poses[k].copy(), float(self.times[k]))

    def _sensor_states(self, drive: Ride, mount: np.ndarray) -> np.ndarray:
        """(frames, 3, 6) x, y, z, yaw, pitch, roll of the sensor at start, middle and end of each sweep."""
        half = 0.0 if self.conditions.scan_motion == "off" else 0.5 / self.profile.rate
        times = (self.times[:, None] + np.array((-half, 0.0, half))).ravel()
        states = drive.states(times, self.world.terrain, mount)
        states[:, 3] = np.unwrap(states[:, 3])
        return states.reshape(len(self), 3, 6)

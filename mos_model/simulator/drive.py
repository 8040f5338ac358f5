"""The way of the sensor's own vehicle: roads, path and speed, and how it pitches, rolls and shakes there."""

import math
from random import Random

import numpy as np

from mos_model.simulator.motion import Path, Speed, draw_speed
from mos_model.simulator.mounting import Mounting
from mos_model.simulator.roads import lay_roads, turning_path
from mos_model.simulator.streets import STYLES
from mos_model.simulator.terrain import REACH, Ground

TURN_RATE = 0.6  # radians/s, at most
SIDE_PUSH = 4.0  # m/s2 sideways, at most
FASTEST = {"residential": 13, "urban": 15, "highway": 22, "country": 20, "open": 10}  # m/s


class Ride:
    """A way and a speed on it."""

    def __init__(
        self, rng: Random, path: Path, start: float, speed: Speed, times: np.ndarray, mounting: Mounting
    ) -> None:
        """`start` m along the path at time 0; `times` (frames,) s of the scans."""
        self.path, self.start, self.speed, self.times, self.mounting = path, start, speed, times, mounting
        self.spin = 0.0  # radians/s, besides
        self._pitching = [(rng.gauss(0, 0.0025), rng.uniform(0.7, 2.0), rng.uniform(0, 6.28)) for _ in range(2)]
        self._rolling = [(rng.gauss(0, 0.003), rng.uniform(0.5, 1.5), rng.uniform(0, 6.28)) for _ in range(2)]
        self._bump = rng.choice((-1, 1)) * rng.uniform(0.01, 0.03) * (rng.random() < 0.1)  # radians
        self._bump_time = rng.uniform(0, float(times[-1]) + 1e-9)

    def places(self, times: np.ndarray) -> np.ndarray:
        """(n, 3) x, y, yaw of the vehicle at `times`."""
        places = self.path.at(self.start + self.speed.at(times)[0])
        if self.spin:
            places[:, 2] += self.spin * times
        return places

    def way(self) -> np.ndarray:
        """(n, 3) x, y, yaw, every metre, of all places that the vehicle comes to."""
        walked = self.speed.at(np.array((self.times[0] - 0.5, self.times[-1] + 0.5)))[0]
        return self.path.at(self.start + np.arange(walked[0] - 1, walked[1] + 2))

    def states(self, times: np.ndarray, terrain: Ground, mount: np.ndarray) -> np.ndarray:
        """(n, 6) position and attitude x, y, z, yaw, pitch, roll of the sensor at `times`; `mount` (4,): its
        height above the ground, and its pitch, roll and yaw in the vehicle."""
        speed = self.speed.at(times)[1]
        x, y, yaw = self.places(times).T
        c, s = np.cos(yaw), np.sin(yaw)

        def height(forward: float, left: float) -> np.ndarray:
            return terrain.heights_at(x + c * forward - s * left, y + s * forward + c * left)

        front, rear = height(1.4, 0), height(-1.4, 0)
        pitch = (rear - front) / 2.8 + mount[1]
        roll = (height(0, 0.8) - height(0, -0.8)) / 1.6 + mount[2]
        shake = np.minimum(speed / 5.0, 1.5)
        pitch += shake * sum(a * np.sin(2 * math.pi * f * times + o) for a, f, o in self._pitching)
        roll += shake * sum(a * np.sin(2 * math.pi * f * times + o) for a, f, o in self._rolling)
        push = (self.speed.at(times + 0.1)[1] - self.speed.at(times - 0.1)[1]) / 0.2
        pitch += shake * self._bump * np.exp(-(((times - self._bump_time) / 0.15) ** 2)) - 0.004 * push
        c, s = math.cos(mount[3]), math.sin(mount[3])
        pitch, roll = c * pitch - s * roll, c * roll + s * pitch
        return np.stack([x, y, 0.5 * (front + rear) + mount[0], yaw + mount[3], pitch, roll], 1)


class Drive(Ride):
    """Drawn before the world is: the world grows around it."""

    def __init__(self, rng: Random, street: str, ego: str, times: np.ndarray, mounting: Mounting) -> None:
        """`times` (frames,) s of the scans; `street` and `ego` as in `SimulationSettings`."""
        duration = float(times[-1])
        fast = rng.uniform(0.4, 1.0) * FASTEST[street]
        if ego == "slow":
            fast = rng.uniform(0.5, 4.0)
        elif ego == "turning":
            fast = rng.uniform(2.5, 7.0)
        fast = min(fast, mounting.pace)
        kind = ego if ego in ("standing", "stop_and_go", "pull_away") else "constant"
        speed = draw_speed(rng, kind, fast, duration)
        travel = max(float(speed.at(times[-1:])[0][0]), 1.0)
        crossing = REACH + rng.uniform(0.1, 0.9) * travel if ego == "turning" else None
        self.roads = lay_roads(rng, STYLES[street], int(travel + 2 * REACH + 20), crossing, travel)
        road = self.roads[0]
        aside = (rng.randrange(road.lanes) + 0.5) * road.lane_width
        if mounting.sidewalk:
            aside = road.half + 0.4 * sum(STYLES[street].walk)
        line = road.line(-aside)
        if crossing is not None:
            side = self.roads[-1]
            aside = aside - road.half + side.half if mounting.sidewalk else 0.5 * side.lane_width
            out = side.line(-aside) if rng.random() < 0.5 else side.line(aside, side.length, 0.0)
            line = turning_path(line, out, rng.uniform(6, 12))
        path = Path(line)
        bend = path.bend(REACH - 10, REACH + travel + 10)
        slow = min(TURN_RATE / (bend + 1e-6), math.sqrt(SIDE_PUSH / (bend + 1e-6)))
        speed = speed.slowed(min(1.0, slow / (float(speed.speed.max()) + 1e-6)))
        super().__init__(rng, path, REACH, speed, times, mounting)

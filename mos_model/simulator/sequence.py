"""One simulated drive: `simulate` gives scan after scan, with pose and labels."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random
from typing import Any

import numpy as np

from mos_model.simulator import ground, rays, raycast, returns
from mos_model.simulator.motion import Path, draw_speed
from mos_model.simulator.roads import turning_path
from mos_model.simulator.sensors import SensorProfile, sensor_profile
from mos_model.simulator.settings import SCAN_MOTIONS, SimulationSettings
from mos_model.simulator.traffic import Traffic
from mos_model.simulator.world import REACH, World
from runtime.errors import SettingError

MOVING_SPEED = 0.5  # m/s, an object that is faster at the time of the scan is moving
STANDING_SPEED = 0.15  # m/s, one that is slower is static; in between it is unlabelled
SURFACE_LABELS = np.array((40, 60, 48, 72, 49), np.uint32)  # of ROAD, MARKING, SIDEWALK, TERRAIN, PAVED
MATERIAL_LOSS = np.array(
    (0.0, 0.01, 0.04, 0.08, 0.03, 0.03, 0.03, 0.01, 0.01)
)  # share of returns lost, by material
RADII = 1.6 * 1.035 ** np.arange(115)  # m, where the ground is looked up along a column


@dataclass(frozen=True)
class Frame:
    """One scan. Poses are T_world_lidar at the middle of the sweep."""

    points: np.ndarray  # (N, 4) float32: x y z m in the LiDAR frame, remission 0..1
    labels: np.ndarray  # (N,) uint32, SemanticKITTI: class in the lower 16 bits, instance in the upper
    pose: np.ndarray  # (4, 4) float64, as an odometry would report it
    true_pose: np.ndarray  # (4, 4) float64
    time: float  # s


def simulate(seed: int, frames: int, sensor: str | SensorProfile = "hdl64e", **settings: Any) -> "Simulation":
    """A simulated drive of `frames` scans: iterate over it, or index it. The same arguments give the same data.

    `settings` are the fields of `SimulationSettings`. Raises SettingError for settings that cannot be.
    """
    try:
        chosen = SimulationSettings(**settings)
    except TypeError as error:
        raise SettingError(f"unknown simulation setting: {error}") from error
    return Simulation(seed, frames, sensor_profile(sensor), chosen)


class Simulation:
    """A drawn street, its traffic, the sensor and its way through it."""

    def __init__(self, seed: int, frames: int, profile: SensorProfile, settings: SimulationSettings) -> None:
        if not isinstance(frames, int) or frames < 1:
            raise SettingError(f"frames must be a whole number of at least 1, not {frames!r}")
        if not isinstance(seed, int) or seed < 0:
            raise SettingError(f"seed must be a whole number of at least 0, not {seed!r}")
        self.seed, self.frames, self.profile, self.settings = seed, frames, profile, settings
        rng = Random(seed)
        self.times = np.arange(frames) / profile.rate
        self._draw_conditions(rng)
        self._draw_way(rng)
        self._draw_traffic(rng)
        self._draw_sensor(rng)
        self._draw_odometry(rng)

    def __len__(self) -> int:
        return self.frames

    def __iter__(self) -> Iterator[Frame]:
        return (self[k] for k in range(self.frames))

    # What is drawn once

    def _draw_conditions(self, rng: Random) -> None:
        s = self.settings
        streets = ("residential", "urban", "highway", "country", "open")
        motions = ("standing", "slow", "cruise", "stop_and_go", "pull_away", "turning")
        street, ego = (
            rng.choices(streets, (34, 30, 10, 14, 12))[0],
            rng.choices(motions, (22, 13, 35, 8, 9, 13))[0],
        )
        motion = rng.choices(SCAN_MOTIONS, (15, 40, 45))[0]
        density = 0.0 if rng.random() < 0.1 else rng.choice((0.35, 0.7, 1.0, 1.0, 1.6, 2.5))
        noise = 0.0 if rng.random() < 0.08 else min(max(rng.lognormvariate(-0.3, 0.6), 0.15), 3.0)
        self.street = street if s.street == "random" else s.street
        self.ego = ego if s.ego == "random" else s.ego
        self.scan_motion = motion if s.scan_motion == "random" else s.scan_motion
        self.density = density if s.movers is None else float(s.movers)
        self.pose_noise = noise if s.pose_noise is None else float(s.pose_noise)

    def _draw_way(self, rng: Random) -> None:
        """The sensor's speed, the world along its way, and its path."""
        duration, ego = float(self.times[-1]), self.ego
        fastest = {"residential": 13, "urban": 15, "highway": 22, "country": 20, "open": 10}[self.street]
        fast = rng.uniform(0.4, 1.0) * fastest
        if ego == "slow":
            fast = rng.uniform(0.5, 4.0)
        elif ego == "turning":
            fast = rng.uniform(2.5, 7.0)
        kind = ego if ego in ("standing", "stop_and_go", "pull_away") else "constant"
        self.ego_speed = draw_speed(rng, kind, fast, duration)
        travel = max(float(self.ego_speed.at(self.times[-1:])[0][0]), 1.0)
        crossing = REACH + rng.uniform(0.1, 0.9) * travel if ego == "turning" else None
        self.world = World(rng, self.street, travel, crossing)
        road = self.world.roads[0]
        lane = rng.randrange(road.lanes)
        line = road.line(-(lane + 0.5) * road.lane_width)
        start = REACH
        if crossing is not None:
            side = self.world.roads[-1]
            aside = 0.5 * side.lane_width
            out = side.line(-aside) if rng.random() < 0.5 else side.line(aside, side.length, 0.0)
            line = turning_path(line, out, rng.uniform(6, 12))
        self.path = Path(line)
        self._pitching = [
            (rng.gauss(0, 0.0025), rng.uniform(0.7, 2.0), rng.uniform(0, 6.28)) for _ in range(2)
        ]
        self._rolling = [(rng.gauss(0, 0.003), rng.uniform(0.5, 1.5), rng.uniform(0, 6.28)) for _ in range(2)]
        self._bump = (
            rng.uniform(0, duration + 1e-9),
            rng.choice((-1, 1)) * rng.uniform(0.01, 0.03) * (rng.random() < 0.1),
        )
        self._start = start

    def _draw_traffic(self, rng: Random) -> None:
        walked = self._start + self.ego_speed.at(self.times)[0]
        self.traffic = Traffic(
            rng, self.world, self.path.at(walked), self.ego_speed, self.path, self.times, self.density
        )
        tracks, fixed = self.traffic.tracks, len(self.world.labels)
        self._first = np.cumsum([len(self.world.prims), *(len(t.shape) for t in tracks)])
        self.prims = np.zeros((int(self._first[-1]), raycast.COLUMNS))
        self.prims[: len(self.world.prims)] = self.world.prims
        for k, track in enumerate(tracks):
            track.shape[:, 15] = fixed + k
        self.velocity = np.zeros((fixed + len(tracks), 2))
        self.labels = np.concatenate([self.world.labels, np.zeros(len(tracks), np.uint32)])
        self.boxes = raycast.bounds(self.prims)

    def _draw_sensor(self, rng: Random) -> None:
        p, vary = self.profile, self.settings.sensor_variation
        elevation = np.radians(np.array(p.elevations))
        self._mount = np.array((p.mount_height, 0.0, 0.0))
        self._offset = np.zeros(p.beams)
        self._noise, self._loss, self._stray = p.range_noise, p.dropout, 0.0
        noise = np.random.default_rng(rng.getrandbits(32))
        bias = p.beam_bias * noise.standard_normal(p.beams)
        albedo = np.array((0.2, 0.6, 0.3, 0.35, 0.25))
        rough = np.array((0.0, 0.0, 0.0, 0.1, 0.0))
        self._sensitivity = p.sensitivity
        if vary:
            middle = elevation.mean()
            elevation = (
                middle
                + (elevation - middle) * (1 + 0.01 * noise.uniform(-1, 1))
                + np.radians(noise.uniform(-0.3, 0.3))
            )
            elevation = np.sort(elevation + np.radians(0.03) * noise.standard_normal(p.beams))[::-1].copy()
            self._mount = np.array((p.mount_height + rng.uniform(-0.15, 0.25), math.radians(rng.gauss(0, 0.5)),
                                    math.radians(rng.gauss(0, 0.5))))  # fmt: skip
            self._offset = np.radians(noise.uniform(-0.1, 0.1, p.beams))
            self._noise *= rng.choice((0.6, 0.8, 1.0, 1.0, 1.8))
            self._loss = p.dropout * rng.choice((0.2, 0.5, 1.0, 1.0, 4.0))
            self._stray = rng.choice((0.0, 0.0, 2e-5, 2e-4))
            self._sensitivity *= rng.uniform(0.5, 2.0)
            albedo *= noise.uniform(0.6, 1.4, 5)
            rough[3] = rng.choice((0.03, 0.1, 0.2, 0.35))
        self._elevation, self._bias, self._albedo, self._rough = elevation, bias, albedo, rough
        self._tangent = np.tan(elevation)
        self._drop = -np.repeat(np.array(p.lifts), p.beams // len(p.lifts))
        self._hidden = self._draw_hidden(rng) if vary and p.self_hidden and rng.random() < 0.8 else None
        shape = (p.azimuth_steps, p.beams)
        self._world_rays = np.empty((*shape, 3), np.float32)
        self._slope, self._depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
        self._hit, self._cosine = np.empty(shape, np.int32), np.empty(shape, np.float32)
        self._origin, self._level = np.empty((shape[0], 3)), np.empty((shape[0], 3))
        self._phase = np.empty(shape[0])

    def _draw_hidden(self, rng: Random) -> np.ndarray:
        """(columns, beams) rays that the vehicle's own roof, racks and cameras stop."""
        p = self.profile
        azimuth = np.arange(p.azimuth_steps) * (360.0 / p.azimuth_steps)
        limit = np.full(p.azimuth_steps, -90.0)
        wedges = [
            (180, rng.uniform(10, 50), rng.uniform(-21, -17)),
            (0, rng.uniform(10, 60), rng.uniform(-23, -19)),
        ]
        wedges += [
            (rng.uniform(0, 360), rng.uniform(2, 14), rng.uniform(-23, -15)) for _ in range(rng.randint(1, 6))
        ]
        for centre, half, top in wedges:
            away = np.abs((azimuth - centre + 180) % 360 - 180) / half
            limit = np.maximum(
                limit, np.where(away < 1, top - 5 * np.maximum(away - 0.6, 0) ** 2 / 0.16, -90.0)
            )
        jag = np.random.default_rng(rng.getrandbits(32)).normal(0, 0.25, p.azimuth_steps)
        return np.degrees(self._elevation)[None] < (limit + jag)[:, None]

    def _draw_odometry(self, rng: Random) -> None:
        """True sensor states (frames, 3, 6) at the start, middle and end of each sweep; reported poses."""
        half = 0.5 / self.profile.rate
        times = self.times[:, None] + np.array((-half, 0.0, half))
        if self.scan_motion == "off":
            times[:] = self.times[:, None]
        states = self._states(times.ravel()).reshape(self.frames, 3, 6)
        states[:, :, 3] = np.unwrap(states[:, :, 3].ravel()).reshape(self.frames, 3)
        self.states = states
        noise, n = np.random.default_rng(rng.getrandbits(32)), self.pose_noise
        jitter, tilt = n * rng.uniform(0.003, 0.02), n * math.radians(rng.uniform(0.01, 0.06))
        drift, swing = n * rng.uniform(0.001, 0.01), n * math.radians(rng.uniform(0.003, 0.02))
        wander = np.eye(4)
        self.poses, self.true_poses = [], []
        for k in range(self.frames):
            true = np.eye(4)
            true[:3, :3], true[:3, 3] = rays.rotation(*states[k, 1, 3:]), states[k, 1, :3]
            self.true_poses.append(true)
            wander = wander @ _small(noise.normal(0, drift, 3), noise.normal(0, swing, 3))
            self.poses.append(true @ wander @ _small(noise.normal(0, jitter, 3), noise.normal(0, tilt, 3)))
        self._misjudged = 1.0 + np.array([rng.gauss(0, 0.03) for _ in range(6)])

    def _states(self, t: np.ndarray) -> np.ndarray:
        """Position and attitude (n, 6) of the sensor at times t."""
        w, path = self.world, self.path
        walked, speed = self.ego_speed.at(t)
        x, y, yaw = path.at(self._start + walked).T
        c, s = np.cos(yaw), np.sin(yaw)

        def height(forward: float, left: float) -> np.ndarray:
            gx, gy = x + c * forward - s * left, y + s * forward + c * left
            return ground.bilinear_many(w.height, w.x0, w.y0, w.cell, gx, gy)

        pitch = -(height(1.4, 0) - height(-1.4, 0)) / 2.8 + self._mount[1]
        roll = (height(0, 0.8) - height(0, -0.8)) / 1.6 + self._mount[2]
        shake = np.minimum(speed / 5.0, 1.5)
        for a, f, o in self._pitching:
            pitch = pitch + shake * a * np.sin(2 * math.pi * f * t + o)
        for a, f, o in self._rolling:
            roll = roll + shake * a * np.sin(2 * math.pi * f * t + o)
        push = (self.ego_speed.at(t + 0.1)[1] - self.ego_speed.at(t - 0.1)[1]) / 0.2
        bump = self._bump[1] * shake * np.exp(-(((t - self._bump[0]) / 0.15) ** 2))
        pitch = pitch - 0.004 * push + bump
        z = 0.5 * (height(1.4, 0) + height(-1.4, 0)) + self._mount[0]
        return np.stack([x, y, z, yaw, pitch, roll], 1)

    # Scans

    def __getitem__(self, k: int) -> Frame:
        """Scan k."""
        if not 0 <= k < self.frames:
            raise IndexError(f"frame {k} of a simulation of {self.frames} frames")
        p, w = self.profile, self.world
        seeds = np.random.default_rng((self.seed, k)).integers(1, 2**62, 4)
        states, duration = self.states[k], 0.0 if self.scan_motion == "off" else 1.0 / p.rate
        self._move_traffic(k)
        azimuth = rays.firing_ticks(p.azimuth_steps, p.encoder_steps, float(seeds[3] % 1000) / 1000.0)
        local = rays.local_rays(azimuth, self._elevation, self._offset)
        rays.world_rays(
            local, azimuth, states, self._world_rays, self._slope, self._origin, self._level, self._phase
        )
        ground.cast_ground(
            self._world_rays, self._slope, self._origin, self._level, self._drop, w.height, w.surface, w.x0, w.y0,
            w.cell, w.highest, RADII, self._rough, seeds[0], self._depth, self._hit,
        )  # fmt: skip
        order = raycast.sort_near(self.prims, self.boxes, states[1, 0], states[1, 1], p.max_range + 2.0)
        raycast.cast_primitives(
            self.prims, self.boxes, order, self.velocity, self._world_rays, self._slope, self._origin, self._level,
            self._phase, self._drop, self._tangent, states, duration, seeds[1], self._depth, self._hit, self._cosine,
        )  # fmt: skip
        restore = self._restore(states)
        hidden = self._hidden if self._hidden is not None else np.zeros(self._depth.shape, np.bool_)
        points, labels = returns.report(
            self._depth, self._hit, self._cosine, self.prims, self.labels, SURFACE_LABELS, self._albedo, MATERIAL_LOSS,
            local, self._world_rays, self._drop, restore, hidden, self._bias, np.array((p.min_range, p.max_range)),
            self._noise, self._sensitivity, self._loss, self._stray, p.remission_step, self.settings.imperfections, seeds[2],
        )  # fmt: skip
        if self.settings.origin_point:
            points = np.concatenate([points, np.zeros((1, 4), np.float32)])
            labels = np.concatenate([labels, np.zeros(1, np.uint32)])
        return Frame(points, labels, self.poses[k].copy(), self.true_poses[k].copy(), float(self.times[k]))

    def _move_traffic(self, k: int) -> None:
        w, fixed = self.world, len(self.world.labels)
        for i, track in enumerate(self.traffic.tracks):
            x, y, yaw, speed, walked = track.states[k].tolist()
            first = int(self._first[i])
            pose = np.array((x, y, w.ground_at(x, y), yaw))
            raycast.place(track.shape, pose, walked, self.prims, first)
            before, after = track.states[max(k - 1, 0)], track.states[min(k + 1, self.frames - 1)]
            way = after[:2] - before[:2]
            self.velocity[fixed + i] = speed * way / max(float(np.hypot(*way)), 1e-9)
            standing, moving = track.labels
            label = moving if speed > MOVING_SPEED else standing if speed < STANDING_SPEED else 0
            self.labels[fixed + i] = label | ((fixed + i + 1) & 0xFFFF) << 16
        first = len(w.prims)
        self.boxes[first:] = raycast.bounds(self.prims[first:])

    def _restore(self, states: np.ndarray) -> np.ndarray:
        """(columns, 3, 4) what takes a point measured at a column to the frame of the scan."""
        if self.scan_motion != "compensated":
            return np.broadcast_to(np.eye(4)[:3], (self.profile.azimuth_steps, 3, 4)).copy()
        guess = states[1] + (states - states[1]) * self._misjudged
        return rays.restoring(guess, self._phase)


def _small(shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A small rigid motion (4, 4)."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rays.rotation(turn[2], turn[1], turn[0]), shift
    return out

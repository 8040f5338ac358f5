"""A sequence in a room: the way of the robot or tripod there, and what moves around it."""

import math
from random import Random

import numpy as np

from mos_model.simulator import interiors, shapes, vehicles
from mos_model.simulator.drive import Ride
from mos_model.simulator.interiors import WALL
from mos_model.simulator.motion import Path, Speed, draw_speed
from mos_model.simulator.mounting import Mounting
from mos_model.simulator.pedestrians import pedestrian
from mos_model.simulator.placing import clearance
from mos_model.simulator.rooms import Place, Room
from mos_model.simulator.settings import Conditions
from mos_model.simulator.traffic import CAR, Draw, Track, keep_apart, poisson
from mos_model.simulator.walkers import Walkers
from runtime.classes import KINDS, MOVING_LABEL

BESIDE = 0.45  # m, from the sensor to what stands
MOST = 30  # tracks


class Indoors:
    """A furnished room, who is in it, and the sensor's way: `world`, `tracks`, `drive`."""

    def __init__(self, seed: int, conditions: Conditions, times: np.ndarray, mounting: Mounting) -> None:
        """`times` (frames,) s of the scans."""
        density = conditions.density
        self.rng = Random(f"room {seed}")
        self.world, self.times = Room(self.rng, conditions.street), times
        self.drive = self._ride(conditions.ego, mounting)
        self.ego = self.drive.places(times)  # (frames, 3) x, y, yaw
        self.world.keep_free(self.ego[:, :2], BESIDE)
        self.world.furnish()
        opened = self._doors(density)
        self.walkers = Walkers(self.rng, self.world.prims, self.world.terrain, times, self.ego)
        if density > 0 and self.rng.random() < 0.75:
            self._fill(density * self.world.style.people)
        self.tracks = keep_apart(self.walkers.tracks, self.ego, mounting.size, MOST) + opened
        self._turn(self.rng.uniform(-math.pi, math.pi))

    def _somewhere(self, margin: float) -> Place:
        rng, room = self.rng, self.world
        x, y = (max(0.5 * long - margin, 0.0) * rng.uniform(-1, 1) for long in (room.length, room.width))
        yaw = rng.choice((0, math.pi)) + rng.gauss(0, 0.1) if room.width < 4 < room.length else rng.uniform(-3.15, 3.15)
        return x, y, yaw

    def _ride(self, ego: str, mounting: Mounting) -> Ride:
        rng, room, duration = self.rng, self.world, float(self.times[-1])
        kind = ego if ego in ("standing", "stop_and_go", "pull_away") else "constant"
        if ego == "turning" and rng.random() < 0.6:
            kind = "standing"
        speed = draw_speed(rng, kind, min(mounting.pace, rng.uniform(0.2, 1.5)), duration, 1.0)
        travel = float(np.abs(speed.walked).max()) + 0.1
        limits = 0.5 * np.array((room.length, room.width)) - BESIDE
        bend = rng.gauss(0, 0.25)
        for _ in range(40):
            x, y, yaw = self._somewhere(BESIDE)
            heading = yaw + bend * np.arange(-travel, travel + 0.2, 0.2)
            steps = np.cumsum(0.2 * np.stack([np.cos(heading), np.sin(heading)], 1), axis=0)
            line = steps - steps[len(steps) // 2] + (x, y)
            if (np.abs(line) <= limits).all():
                break
        else:
            x, y, yaw = self._somewhere(BESIDE + 0.1)
            line = np.array([(x, y), (x + math.cos(yaw), y + math.sin(yaw))])
            speed = Speed(duration, np.zeros(2), np.array((-1.0, duration + 1)))
        path = Path(line)
        ride = Ride(rng, path, 0.5 * path.length, speed, self.times, mounting)
        if ego == "turning":
            ride.spin = rng.choice((-1, 1)) * rng.uniform(0.1, 1.2)
        return ride

    def _doors(self, density: float) -> list[Track]:
        """Hang the doors; those that open or close are tracks."""
        rng, moving = self.rng, []
        for (x, y, yaw), wide, tall in self.world.doors:
            state, out = rng.random(), rng.choice((-1, 1))
            leaf = interiors.door(rng, wide, tall)
            if density > 0 and state < 0.08:
                fast, begin = rng.uniform(0.5, 1.6), rng.uniform(-2.0, self.times[-1])
                angle = np.clip(fast * (self.times - begin), 0.0, rng.uniform(0.7, 1.8))
                rate = np.gradient(angle, self.times) if len(angle) > 1 else np.zeros(1)
                states = np.zeros((len(angle), 8))
                states[:, 0], states[:, 1], states[:, 2], states[:, 7] = x, y, yaw + out * angle, np.abs(rate)
                moving.append(Track(shapes.array(leaf), (WALL, MOVING_LABEL), wide, 0.1, states))
            elif state < 0.75:
                self.world.add(leaf, WALL, (x, y, yaw))
            elif state < 0.9:
                self.world.add(leaf, WALL, (x, y, yaw + out * rng.uniform(0.3, 2.0)))
        return moving

    def _fill(self, people: float) -> None:
        rng, walkers = self.rng, self.walkers
        for _ in range(6 * min(poisson(rng, 0.5 * people), 16)):
            if len(walkers.tracks) >= 0.8 * people:
                break
            walkers.group(*self._somewhere(0.4), 3, 1.0)
        for _ in range(rng.choice((0, 1, 2, 4))):
            x, y, yaw = self._somewhere(0.4)
            stand = Path(np.array([(x, y), (x + math.cos(yaw), y + math.sin(yaw))]))
            still, turn = (
                draw_speed(rng, "standing", 1.0, walkers.duration),
                rng.uniform(0.5, 2.0) * (rng.random() < 0.15),
            )
            walkers.walk(stand, 0.0, still, pedestrian(rng, indoors=True), 0.05, turn)
        draws: list[tuple[Draw, tuple[int, int], float]] = [(interiors.cart, KINDS["other vehicle"], 1.2)]
        if min(self.world.length, self.world.width) > 8:
            draws.append((interiors.fork_lift, KINDS["other vehicle"], 2.5))
        if self.world.garage:
            draws = [(vehicles.car, CAR, 3.0)]
        for draw, labels, fast in draws:
            for _ in range(6):
                if rng.random() < 0.4:
                    self._drive(draw, labels, rng.uniform(0.25, 1.0) * fast)

    def _drive(self, draw: Draw, labels: tuple[int, int], fast: float) -> None:
        """Something on wheels, if it finds room."""
        rng, walkers = self.rng, self.walkers
        shape, length, width = draw(rng)
        kind = rng.choice(("constant", "constant", "stop_and_go", "pull_away", "brake"))
        walked, pace = draw_speed(rng, kind, fast, walkers.duration, 1.0).at(self.times)
        x, y, yaw = self._somewhere(0.5 * length)
        reach = np.arange(-0.5 * length, walked[-1] + 0.5 * length + 0.2, 0.3)
        spots = np.column_stack([x + reach * math.cos(yaw), y + reach * math.sin(yaw), np.zeros(len(reach))])
        if clearance(walkers.prims, walkers.boxes, spots) < 0.5 * width + 0.1:
            return
        states = np.zeros((len(walked), 8))
        states[:, 0], states[:, 1] = x + walked * math.cos(yaw), y + walked * math.sin(yaw)
        states[:, 2], states[:, 3], states[:, 4], states[:, 6] = yaw, pace, walked, 1.0
        walkers.tracks.append(Track(shapes.array(shape), labels, length, width, states))

    def _turn(self, angle: float) -> None:
        """Turn all of it about the middle of the room: walls lie any way in the world."""
        turn = np.array(((math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))))
        self.world.turn(turn)
        self.drive.path = Path(self.drive.path.points @ turn)
        self.ego = self.drive.places(self.times)
        for track in self.tracks:
            track.states[:, :2] = track.states[:, :2] @ turn
            track.states[:, 2] += angle

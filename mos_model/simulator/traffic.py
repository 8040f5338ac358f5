"""What moves, or could: vehicles in lanes and queues, cyclists, people on foot; each has its track."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

import numpy as np

from mos_model.simulator import people, shapes, vehicles
from mos_model.simulator.drive import Drive
from mos_model.simulator.motion import Path, Speed, draw_speed
from mos_model.simulator.roads import turning_path
from mos_model.simulator.world import World
from runtime.classes import KINDS

MOST = 48  # tracks in a sequence
LONGEST = 17.0  # m, of all objects

Draw = Callable[[Random], tuple[shapes.Shape, float, float]]

# Label while standing and while moving (SemanticKITTI).
CAR, TRUCK, BUS = KINDS["car"], KINDS["truck"], KINDS["bus"]
CYCLIST, MOTORCYCLE, PERSON = KINDS["bicyclist"], KINDS["motorcyclist"], KINDS["person"]
VEHICLES: tuple[tuple[Draw, tuple[int, int], float], ...] = (
    (vehicles.car, CAR, 70),
    (vehicles.van, CAR, 12),
    (vehicles.truck, TRUCK, 8),
    (vehicles.bus, BUS, 4),
    (lambda rng: vehicles.motorcycle(rng, True), MOTORCYCLE, 5),
)


@dataclass
class Track:
    """One object and its way: states (frames, 8) x, y, yaw, speed m/s, walked m, lift above the ground m, vigour of the
    limbs 0..1, speed of what moves in place m/s."""

    shape: np.ndarray  # (n, COLUMNS) primitives in the object's frame
    labels: tuple[int, int]  # standing, moving
    length: float
    width: float
    states: np.ndarray


class Traffic:
    """Draws the tracks of one sequence."""

    def __init__(self, rng: Random, world: World, drive: Drive, density: float) -> None:
        """`density` 1 is usual traffic, 0 none; nothing drives into the sensor's vehicle on its `drive`."""
        self.rng, self.world, self.drive, self.density = rng, world, drive, density
        self.times, self.duration = drive.times, float(drive.times[-1])
        self.ego = drive.places(self.times)  # (frames, 3) x, y, yaw
        self.tracks: list[Track] = []
        if density > 0:
            if not drive.mounting.sidewalk:
                self._follow_ego()
            self._fill_ways()
            self._turn_off()
            self._fill_lanes()

    def add(
        self, draw: Draw, labels: tuple[int, int], path: Path, start: float, speed: Speed, backwards: bool = False
    ) -> None:
        """An object that starts at `start` m of `path`, if it comes near the sensor."""
        walked, pace = speed.at(self.times)
        states = np.column_stack([path.at(start + walked), pace, walked, np.tile((0.0, 1.0, 0.0), (len(walked), 1))])
        if backwards:
            states[:, 2] += math.pi
        if in_view(states, self.ego):
            shape, length, width = draw(self.rng)
            self.tracks.append(Track(shapes.array(shape), labels, length, width, states))

    def vehicle(self) -> tuple[Draw, tuple[int, int]]:
        """Some vehicle."""
        draw, labels, _ = self.rng.choices(VEHICLES, [weight for *_, weight in VEHICLES])[0]
        return draw, labels

    def _follow_ego(self) -> None:
        """Vehicles ahead and behind in the sensor's own lane keep about its speed."""
        rng = self.rng
        for sign in (1, -1):
            gap = 0.0
            while rng.random() < min(0.55 * self.density, 0.85):
                gap += rng.uniform(7, 14) + rng.expovariate(1 / (4 + 1.2 * self.drive.speed.speed.max()))
                if gap > 75:
                    break
                pace = np.maximum(self.drive.speed.speed + rng.gauss(0, 0.15) * (self.drive.speed.speed > 0.5), 0)
                lag = rng.uniform(0.2, 1.0) * sign
                speed = Speed(self.duration, pace, self.drive.speed.times - lag)
                self.add(*self.vehicle(), self.drive.path, self.drive.start + sign * gap, speed)

    def _fill_lanes(self) -> None:
        rng, style = self.rng, self.world.style
        for road in self.world.roads:
            for forward in (True, False):
                for lane in range(road.lanes):
                    aside = (lane + 0.5) * road.lane_width
                    line = road.line(-aside) if forward else road.line(aside, road.length, 0.0)
                    self._fill_lane(Path(line), rng.uniform(*style.speed))

    def _fill_lane(self, path: Path, fast: float) -> None:
        rng = self.rng
        amount = self.world.style.vehicles * self.density * rng.choice((0.0, 0.5, 1.0, 1.0, 1.5, 2.5))
        if amount <= 0:
            return
        mode, s, queue = rng.random(), rng.uniform(-40, 30), 0
        go = rng.uniform(-0.5, self.duration)
        while s < path.length + 20:
            if mode < 0.72:
                kind = rng.choices(("constant", "pull_away", "brake", "standing", "stop_and_go"), (80, 6, 6, 4, 4))[0]
                speed = draw_speed(rng, kind, fast * rng.uniform(0.85, 1.15), self.duration)
                step = 8 + fast * rng.uniform(0.4, 1.0) + rng.expovariate(amount / 100)
            elif mode < 0.9:  # a queue that stands, or starts one after the other
                queue += 1
                push = rng.uniform(1.0, 2.5)
                begin = go + queue * rng.uniform(0.8, 1.5)
                times = np.array([-1.0, begin, begin + fast / push, self.duration + 60])
                speed = Speed(self.duration, np.array([0.0, 0.0, fast, fast]), times)
                step = rng.uniform(6.5, 9) if rng.random() < 0.9 else rng.expovariate(amount / 100)
            else:
                speed = draw_speed(rng, "constant", rng.uniform(0.6, 3.0), self.duration)
                step = rng.uniform(6.5, 15)
            self.add(*self.vehicle(), path, s, speed)
            s += step

    def _turn_off(self) -> None:
        """Vehicles that turn from one road into another."""
        rng, roads = self.rng, self.world.roads
        for _ in range(poisson(rng, 0.6 * self.density) if len(roads) > 1 else 0):
            pair = [roads[0], rng.choice(roads[1:])]
            rng.shuffle(pair)
            lines = []
            for road in pair:
                aside = 0.5 * road.lane_width
                lines.append(road.line(-aside) if rng.random() < 0.5 else road.line(aside, road.length, 0.0))
            before, after = lines
            path = Path(turning_path(before, after, rng.uniform(6, 10)))
            bend = float(path.middle[1:][np.abs(np.diff(path.heading)).argmax()])
            fast = rng.uniform(2.5, 8.0)
            start = bend - rng.uniform(-0.2, 1.0) * fast * self.duration - rng.uniform(0, 8)
            speed = draw_speed(rng, rng.choice(("constant", "constant", "pull_away", "brake")), fast, self.duration)
            self.add(*self.vehicle(), path, start, speed)

    def _fill_ways(self) -> None:
        """People and cyclists near the street, and vehicles that manoeuvre slowly."""
        rng, style, world = self.rng, self.world.style, self.world
        feet = style.walkers * 3.0 * self.density * rng.choice((0.2, 1.0, 1.0, 2.0, 3.5))
        for _ in range(min(poisson(rng, feet), 40)):
            if len(self.tracks) < MOST // 2:
                self._walk()
        for _ in range(min(poisson(rng, (0.4 + 0.4 * style.walkers) * self.density), 8)):
            self._ride()
        for _ in range(poisson(rng, 0.35 * self.density)):
            road = world.roads[0]
            x, y, h = road.at(
                rng.uniform(0.2, 0.8) * road.length, rng.choice((-1, 1)) * (road.half + rng.uniform(1, 8))
            )
            yaw = h + rng.choice((0.5, 1.5)) * math.pi + rng.gauss(0, 0.3)
            way = np.array([[x, y], [x + 30 * math.cos(yaw), y + 30 * math.sin(yaw)]])
            if world.is_free(x, y, yaw, -2.4, 8.0, 1.1):
                speed = draw_speed(
                    rng,
                    rng.choice(("constant", "pull_away", "stop_and_go")),
                    rng.uniform(0.7, 3),
                    self.duration,
                )
                self.add(vehicles.car, CAR, Path(way), 0.0, speed, rng.random() < 0.5)

    def _ride(self) -> None:
        """A cyclist in a lane, beside it or on the sidewalk, either way, mostly near the sensor."""
        rng, world = self.rng, self.world
        road = world.roads[0] if rng.random() < 0.7 else rng.choice(world.roads)
        aside = rng.choice((road.half - road.parking - 0.5, road.half + 0.5 * world.terrain.walk, road.half + 1.5))
        forward = rng.random() < 0.5
        path = Path(road.line(-aside) if forward else road.line(aside, road.length, 0.0))
        middle = self.ego[len(self.ego) // 2]
        nearest = path.s[np.hypot(path.points[:, 0] - middle[0], path.points[:, 1] - middle[1]).argmin()]
        fast = rng.uniform(2, 8)
        kind = rng.choices(("constant", "pull_away", "brake"), (80, 10, 10))[0]
        start = float(nearest) + rng.gauss(0, 25) - 0.5 * fast * self.duration
        self.add(vehicles.cyclist, CYCLIST, path, start, draw_speed(rng, kind, fast, self.duration))

    def _walk(self) -> None:
        """One person, or a few together, along the street, across it or anywhere."""
        rng, world = self.rng, self.world
        if rng.random() < 0.6:
            centre = self.ego[rng.randrange(len(self.ego))]
            away, angle = (
                rng.uniform(3, 40) if rng.random() < 0.8 else rng.uniform(40, 80),
                rng.uniform(-math.pi, math.pi),
            )
            x, y = centre[0] + away * math.cos(angle), centre[1] + away * math.sin(angle)
            yaw = rng.uniform(-math.pi, math.pi)
            if abs(world.terrain.edge_at(x, y)) > 6 and rng.random() < 0.4:
                return
        else:
            road = rng.choice((world.roads[0], rng.choice(world.roads)))
            aside = rng.choice((-1, 1)) * (road.half + rng.uniform(0.4, world.terrain.walk + 1.0))
            x, y, yaw = road.at(rng.uniform(0, 1) * road.length, aside)
            yaw += rng.choice((0, math.pi)) + rng.gauss(0, 0.05)
            if rng.random() < 0.3:
                yaw += 0.5 * math.pi
        fast = rng.uniform(2.4, 3.8) if rng.random() < 0.1 else rng.uniform(0.6, 1.8)
        kind = rng.choices(("constant", "pull_away", "brake", "standing"), (86, 5, 5, 4))[0]
        along = fast * self.duration + 4.0
        u = np.linspace(-0.5, 0.5, 12)
        sway = rng.gauss(0, 0.4) * np.sin(6.3 * (u + rng.random()))
        c, s = math.cos(yaw), math.sin(yaw)
        middle = np.stack([x + along * u * c - sway * s, y + along * u * s + sway * c], 1)
        speed = draw_speed(rng, kind, fast, self.duration, 1.5)
        for index in range(rng.choice((1, 1, 1, 1, 2, 2, 3, 4))):
            shift = np.array((rng.gauss(0, 0.3), 0.75 * index))
            path = Path(middle + np.array((shift[0] * c - shift[1] * s, shift[0] * s + shift[1] * c)))
            spots = path.at(np.linspace(1.0, along - 2.0, 7))
            if all(world.is_free(px, py, 0.0, -0.2, 0.2, 0.2) for px, py, _ in spots.tolist()):
                self.add(lambda r: people.person(r, True), PERSON, path, 2.0, speed)


def in_view(states: np.ndarray, ego: np.ndarray) -> bool:
    """Whether an object of these states comes near enough to the sensor to be seen."""
    return bool(np.hypot(states[:, 0] - ego[:, 0], states[:, 1] - ego[:, 1]).min() < 90.0)


def keep_apart(tracks: list[Track], ego: np.ndarray, size: tuple[float, float], most: int = MOST) -> list[Track]:
    """Those that drive neither into the sensor's carrier, of places `ego` (frames, 3) and of length and width `size`
    m, nor into what comes before them; `most` of them."""
    kept = [Track(np.empty((0, 0)), CAR, *size, np.column_stack([ego, np.zeros((len(ego), 5))]))]
    places = np.empty((most + 1, *ego[:, :2].shape))
    places[0] = ego[:, :2]
    for track in tracks:
        if len(kept) > most:
            break
        apart = np.abs(places[: len(kept)] - track.states[:, :2]).max(axis=2).min(axis=1)
        if not any(_touch(track, kept[k]) for k in np.flatnonzero(apart < 0.5 * (track.length + LONGEST) + 1.0)):
            places[len(kept)] = track.states[:, :2]
            kept.append(track)
    return kept[1:]


def poisson(rng: Random, mean: float) -> int:
    """A number of events, `mean` on average."""
    count, left = 0, rng.expovariate(1.0)
    while left < mean:
        count, left = count + 1, left + rng.expovariate(1.0)
    return count


def _touch(a: Track, b: Track) -> bool:
    d = a.states[:, :2] - b.states[:, :2]
    reach = 0.5 * (a.length + b.length)
    if np.abs(d).max(axis=1).min() > reach + 1.0:
        return False
    c, s = np.cos(b.states[:, 2]), np.sin(b.states[:, 2])
    along, across = c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]
    turn = np.abs(np.sin(a.states[:, 2] - b.states[:, 2]))
    wide = 0.5 * (b.width + a.width) + 0.15 + turn * 0.5 * (a.length - a.width)
    long = reach + 0.5 - turn * 0.5 * (a.length - a.width)
    return bool(((np.abs(along) < long) & (np.abs(across) < wide)).any())

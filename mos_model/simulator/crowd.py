"""People on foot as streets have them: alone and in groups, along walls and hedges, between parked cars, across the
road near and far, starting, stopping, turning, standing about."""

import math
from random import Random

import numpy as np

from mos_model.simulator import shapes
from mos_model.simulator.boxes import bounds
from mos_model.simulator.motion import STEP, Path, Speed, draw_speed
from mos_model.simulator.pedestrians import Figure, pedestrian
from mos_model.simulator.placing import clearance
from mos_model.simulator.traffic import PERSON, Track, Traffic, poisson

MOST_PEOPLE = 50
WALK = 1.2  # m/s, who goes slower takes shorter steps
BODY = 0.22  # m, from the middle of somebody to what stands beside
BESIDE = (50, 51, 70)  # labels of what people walk along
PARKED = (10, 13, 18)


class Crowd:
    """Draws people into a street and its traffic."""

    def __init__(self, rng: Random, traffic: Traffic) -> None:
        self.rng, self.traffic, self.world, self.ego = rng, traffic, traffic.world, traffic.ego
        self.times, self.duration = traffic.times, traffic.duration
        self.tracks: list[Track] = []
        self._boxes = bounds(self.world.prims)
        near = [p for p in self.world.placed if np.hypot(self.ego[:, 0] - p[1], self.ego[:, 1] - p[2]).min() < 50]
        self._beside = [p for p in near if p[0] in BESIDE and p[4][1] - p[4][0] > 4]
        self._parked = [p for p in near if p[0] in PARKED]
        usual = self.world.style.walkers * traffic.density * rng.choice((0.5, 1.0, 1.0, 2.0))
        ways = (self._anywhere, self._along_street, self._along_wall, self._past_cars, self._across, self._get_out,
                self._stand, self._far)  # fmt: skip
        wanted = min(poisson(rng, 7.5 * usual + 2.0 * min(traffic.density, 1.0)), MOST_PEOPLE)
        for _ in range(4 * wanted):
            if len(self.tracks) >= wanted:
                break
            rng.choices(ways, (16, 20, 18, 10, 12, 5, 10, 9))[0]()

    # Places

    def _near(self, least: float, most: float) -> tuple[float, float, float]:
        """x, y of a place at that distance from where the sensor comes to, and a heading along its way."""
        x, y, yaw = self.ego[self.rng.randrange(len(self.ego))].tolist()
        away, angle = self.rng.uniform(least, most), self.rng.uniform(-math.pi, math.pi)
        return x + away * math.cos(angle), y + away * math.sin(angle), yaw

    def _anywhere(self) -> None:
        x, y, yaw = self._near(3.0, 50.0)
        turn = self.rng.choice((0.0, math.pi, self.rng.uniform(-math.pi, math.pi)))
        self._group(x, y, yaw + turn + self.rng.gauss(0, 0.1))

    def _along_street(self) -> None:
        rng, road = self.rng, self.world.roads[0] if self.rng.random() < 0.75 else self.rng.choice(self.world.roads)
        x, y, _ = self._near(0.0, 40.0)
        s = float(np.hypot(road.x - x, road.y - y).argmin())
        aside = rng.choice((-1, 1)) * (road.half + rng.uniform(0.3, self.world.terrain.walk + 0.6))
        x, y, yaw = road.at(s, aside)
        self._group(x, y, yaw + rng.choice((0, math.pi)) + rng.gauss(0, 0.04))

    def _along_wall(self) -> None:
        """Close to a house, wall, fence or hedge."""
        if not self._beside:
            return
        rng = self.rng
        _, x, y, yaw, (rear, front, half) = rng.choice(self._beside)
        side, along = rng.choice((-1, 1)), rng.uniform(rear, front)
        c, s = math.cos(yaw), math.sin(yaw)
        for away in (half + rng.uniform(0.5, 1.2), half + rng.uniform(0.9, 1.6)):
            px, py = x + c * along - s * side * away, y + s * along + c * side * away
            if self._group(px, py, yaw + rng.choice((0, math.pi)), rng.choice((1, 1, 1, 2))):
                return

    def _past_cars(self) -> None:
        """Along the far side of parked cars, or between two of them."""
        if not self._parked:
            return
        rng = self.rng
        _, x, y, yaw, (rear, front, half) = rng.choice(self._parked)
        along, aside, turn = rng.uniform(rear, front), rng.choice((-1, 1)) * (half + rng.uniform(0.45, 1.0)), 0.0
        if rng.random() < 0.45:
            along, aside, turn = rng.choice((rear - 0.45, front + 0.45)), rng.uniform(-2, 2), 0.5 * math.pi
        c, s = math.cos(yaw), math.sin(yaw)
        yaw += turn + rng.choice((0, math.pi))
        self._group(x + c * along - s * aside, y + s * along + c * aside, yaw, 1)

    def _across(self) -> None:
        """Across the way of the sensor, before it."""
        rng = self.rng
        x, y, yaw = self.ego[rng.randrange(len(self.ego))].tolist()
        ahead = rng.uniform(4, 30)
        yaw_there = yaw + rng.choice((-0.5, 0.5)) * math.pi + rng.gauss(0, 0.15)
        self._group(x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), yaw_there)

    def _far(self) -> None:
        """30 to 60 m ahead or behind, across the road or along it."""
        rng = self.rng
        x, y, yaw = self.ego[rng.randrange(len(self.ego))].tolist()
        away, aside = rng.choice((-1, 1, 1)) * rng.uniform(30, 60), rng.gauss(0, 6)
        turn = rng.choice((0.0, 0.5, -0.5, 1.0)) * math.pi
        c, s = math.cos(yaw), math.sin(yaw)
        self._group(x + away * c - aside * s, y + away * s + aside * c, yaw + turn)

    def _get_out(self) -> None:
        """Beside the door of a parked car, then away from it."""
        if not self._parked:
            return
        rng = self.rng
        _, x, y, yaw, (*_, half) = rng.choice(self._parked)
        side, c, s = rng.choice((-1, 1)), math.cos(yaw), math.sin(yaw)
        aside = np.array((0.45, 0.6, 0.8, 1.0, 1.2)) + half
        along = rng.uniform(-0.3, 0.6) + np.array((0.0, 0.05, 0.6, 2.0, 5.0)) * rng.choice((-1, 1))
        line = np.stack([x + c * along - s * side * aside, y + s * along + c * side * aside], 1)
        speed = draw_speed(rng, rng.choice(("pull_away", "constant", "stop_and_go")), 0.9, self.duration, 1.5)
        self._walk(Path(line), 0.0, speed, pedestrian(rng, child=False), 0.15)

    def _stand(self) -> None:
        """Some who stand together; one of them may turn about, or leave."""
        rng = self.rng
        x, y, _ = self._near(3.0, 40.0)
        for _ in range(rng.choice((1, 1, 2, 3, 4))):
            px, py, yaw = x + rng.gauss(0, 0.7), y + rng.gauss(0, 0.7), rng.uniform(-math.pi, math.pi)
            path = Path(np.array([(px, py), (px + 5 * math.cos(yaw), py + 5 * math.sin(yaw))]))
            kind, turning = rng.choices(("standing", "pull_away"), (80, 20))[0], rng.random() < 0.2
            speed = draw_speed(rng, kind, rng.uniform(0.8, 1.6), self.duration, 1.5)
            self._walk(path, 0.0, speed, pedestrian(rng), 0.1, rng.choice((-1, 1)) * turning * rng.uniform(0.5, 2.0))

    # People

    def _group(self, x: float, y: float, yaw: float, most: int = 6) -> bool:
        """One, or some side by side, whose way leads through there: whether anybody found room."""
        rng = self.rng
        runs = rng.random() < 0.09
        fast = rng.uniform(2.2, 4.0) if runs else min(max(rng.gauss(1.3, 0.25), 0.5), 2.0)
        kinds = ("constant", "stop_and_go", "pull_away", "brake")
        speed = draw_speed(rng, rng.choices(kinds, (66, 12, 11, 11))[0], fast, self.duration, 1.5)
        along = float(speed.at(self.times[-1:])[0][0])
        u = np.linspace(-0.5, 0.5, 9) * (along + 2.0)
        sway = rng.gauss(0, 0.15) * np.sin(2.5 * u / (0.3 * along + 3.0) + 6.3 * rng.random())
        c, s = math.cos(yaw), math.sin(yaw)
        found = False
        for index in range(min(rng.choices((1, 2, 3, 4, 5, 6), (58, 22, 9, 6, 3, 2))[0], most)):
            ahead, aside = -0.9 * (index // 3) + rng.gauss(0, 0.12), 0.85 * (index % 3)
            line = np.stack([u + ahead, sway + aside], 1) @ np.array([(c, s), (-s, c)]) + (x, y)
            child = None if index == 0 else rng.random() < 0.2
            found |= self._walk(Path(line), 1.0, speed, pedestrian(rng, runs, child))
        return found

    def _walk(
        self, path: Path, start: float, speed: Speed, figure: Figure, gap: float = 0.1, turn: float = 0.0
    ) -> bool:
        """Add somebody who starts at `start` m of `path`, turning on the spot by `turn` radians/s, if nothing stands
        within `gap` m of the body on all of that way."""
        states = gait(path, start, speed, figure, self.times, turn)
        if not self.traffic.in_view(states):
            return False
        terrain = self.world.terrain
        steps = np.unique(np.linspace(0, len(states) - 1, 2 + int(2 * np.ptp(states[:, 4]))).astype(int))
        spots = np.column_stack([states[steps, :2], terrain.heights_at(*states[steps, :2].T)])
        if clearance(self.world.prims, self._boxes, spots) < BODY + gap:
            return False
        shape = shapes.array(figure.shape)
        self.tracks.append(Track(shape, PERSON, figure.length, figure.width, states))
        return True


def gait(path: Path, start: float, speed: Speed, figure: Figure, times: np.ndarray, turn: float) -> np.ndarray:
    """States (frames, 8), as in `Track`, of somebody on foot; `turn` radians/s on the spot."""
    walked, pace = speed.at(times)
    share = np.clip(np.sqrt(speed.speed / WALK), 0.35, 1.0)  # of the usual step
    steps = np.interp(times, speed.times, np.cumsum(speed.speed / share) * STEP) + 0.3 * abs(turn) * times
    vigour = np.clip(np.sqrt(pace / WALK), 0.0, 1.0)
    if turn:
        vigour = np.maximum(vigour, 0.3)
    phase = 2 * math.pi * steps / figure.stride + figure.phase
    x, y, yaw = path.at(start + walked).T
    lean = -figure.sway * vigour * np.cos(phase)
    x, y, yaw = x - np.sin(yaw) * lean, y + np.cos(yaw) * lean, yaw + turn * times
    lift = -figure.bob * (vigour * np.sin(phase)) ** 2
    return np.column_stack([x, y, yaw, pace, steps, lift, vigour, np.full(len(times), float(abs(turn)))])

"""People on foot as streets have them: alone and in groups, along walls and hedges, between parked cars, across the
road near and far, starting, stopping, turning, standing about."""

import math
from random import Random

import numpy as np

from mos_model.simulator.motion import Path, draw_speed
from mos_model.simulator.pedestrians import pedestrian
from mos_model.simulator.traffic import Traffic, poisson
from mos_model.simulator.walkers import Walkers

MOST_PEOPLE = 50
BESIDE = (50, 51, 70)  # labels of what people walk along
PARKED = (10, 13, 18)


class Crowd(Walkers):
    """Draws people into a street and its traffic."""

    indoors = False

    def __init__(self, rng: Random, traffic: Traffic) -> None:
        self.world = traffic.world
        super().__init__(rng, self.world.prims, self.world.terrain, traffic.times, traffic.ego)
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

    def _near(self, least: float, most: float) -> tuple[float, float, float]:
        """x, y of a place at that distance from where the sensor comes to, and a heading along its way."""
        x, y, yaw = self.ego[self.rng.randrange(len(self.ego))].tolist()
        away, angle = self.rng.uniform(least, most), self.rng.uniform(-math.pi, math.pi)
        return x + away * math.cos(angle), y + away * math.sin(angle), yaw

    def _anywhere(self) -> None:
        x, y, yaw = self._near(3.0, 50.0)
        turn = self.rng.choice((0.0, math.pi, self.rng.uniform(-math.pi, math.pi)))
        self.group(x, y, yaw + turn + self.rng.gauss(0, 0.1))

    def _along_street(self) -> None:
        rng, road = self.rng, self.world.roads[0] if self.rng.random() < 0.75 else self.rng.choice(self.world.roads)
        x, y, _ = self._near(0.0, 40.0)
        s = float(np.hypot(road.x - x, road.y - y).argmin())
        aside = rng.choice((-1, 1)) * (road.half + rng.uniform(0.3, self.world.terrain.walk + 0.6))
        x, y, yaw = road.at(s, aside)
        self.group(x, y, yaw + rng.choice((0, math.pi)) + rng.gauss(0, 0.04))

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
            if self.group(px, py, yaw + rng.choice((0, math.pi)), rng.choice((1, 1, 1, 2))):
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
        self.group(x + c * along - s * aside, y + s * along + c * aside, yaw, 1)

    def _across(self) -> None:
        """Across the way of the sensor, before it."""
        rng = self.rng
        x, y, yaw = self.ego[rng.randrange(len(self.ego))].tolist()
        ahead = rng.uniform(4, 30)
        yaw_there = yaw + rng.choice((-0.5, 0.5)) * math.pi + rng.gauss(0, 0.15)
        self.group(x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), yaw_there)

    def _far(self) -> None:
        """30 to 60 m ahead or behind, across the road or along it."""
        rng = self.rng
        x, y, yaw = self.ego[rng.randrange(len(self.ego))].tolist()
        away, aside = rng.choice((-1, 1, 1)) * rng.uniform(30, 60), rng.gauss(0, 6)
        turn = rng.choice((0.0, 0.5, -0.5, 1.0)) * math.pi
        c, s = math.cos(yaw), math.sin(yaw)
        self.group(x + away * c - aside * s, y + away * s + aside * c, yaw + turn)

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
        self.walk(Path(line), 0.0, speed, pedestrian(rng, child=False), 0.15)

    def _stand(self) -> None:
        """Some who stand together; one of them may turn about, or leave."""
        rng = self.rng
        x, y, _ = self._near(3.0, 40.0)
        for _ in range(rng.choice((1, 1, 2, 3, 4))):
            px, py, yaw = x + rng.gauss(0, 0.7), y + rng.gauss(0, 0.7), rng.uniform(-math.pi, math.pi)
            path = Path(np.array([(px, py), (px + 5 * math.cos(yaw), py + 5 * math.sin(yaw))]))
            kind, turning = rng.choices(("standing", "pull_away"), (80, 20))[0], rng.random() < 0.2
            speed = draw_speed(rng, kind, rng.uniform(0.8, 1.6), self.duration, 1.5)
            self.walk(path, 0.0, speed, pedestrian(rng), 0.1, rng.choice((-1, 1)) * turning * rng.uniform(0.5, 2.0))

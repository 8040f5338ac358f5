"""The standing world of one sequence: buildings, plants, street furniture, parked cars, standing people."""

import math
from collections.abc import Iterator
from random import Random

import numpy as np

from mos_model.simulator import furniture, people, plants, shapes, vehicles
from mos_model.simulator.placing import claim, place
from mos_model.simulator.raycast import COLUMNS
from mos_model.simulator.roads import Road
from mos_model.simulator.streets import StreetStyle
from mos_model.simulator.terrain import Terrain

Foot = tuple[float, float, float]  # m: rear, front, half width of the floor that an object takes
PLAN = 0.5  # m, cell of the floor plan


class World:
    """Everything that stands still. Coordinates in m, z up."""

    def __init__(
        self, rng: Random, style: StreetStyle, roads: list[Road], terrain: Terrain, way: np.ndarray,
        body: tuple[float, float],
    ) -> None:  # fmt: skip
        """Furnish the roads, but nothing on `way` (n, 3) x, y, yaw, the places of the sensor's vehicle; `body`: half
        its length and width, m."""
        self.rng, self.style, self.roads, self.terrain = rng, style, roads, terrain
        self._plan = np.zeros([int(n / PLAN) for n in terrain.edge.shape], np.bool_)
        self._rows: list[np.ndarray] = []
        self._labels: list[int] = []
        self.placed: list[tuple[int, float, float, float, Foot]] = []  # label, x, y, yaw and foot of each object
        passed = self._passed(way, *body)
        self._plan |= passed
        for road in roads:
            for side in (-1, 1):
                self._fill_frontage(road, side)
                self._fill_kerb(road, side)
        self._fill_background()
        self._scatter()
        self._plan &= ~passed  # walkers may cross it
        self.prims = np.concatenate(self._rows) if self._rows else np.zeros((0, COLUMNS))  # (n, COLUMNS)
        self.labels = np.array(self._labels, np.uint32)  # (objects,)

    def is_free(
        self, x: float, y: float, yaw: float, rear: float, front: float, half: float, mark: bool = False
    ) -> bool:
        """Whether nothing stands in that rectangle; `mark` takes it if so."""
        t = self.terrain
        free: bool = claim(self._plan, t.x0, t.y0, PLAN, x, y, yaw, rear, front, half, mark)
        return free

    def _passed(self, way: np.ndarray, long: float, wide: float) -> np.ndarray:
        """(rows, columns) bool, the cells of the floor plan that the sensor's vehicle comes to."""
        passed = np.zeros_like(self._plan)
        along, aside = (
            a.ravel() for a in np.meshgrid(np.arange(-long, long + 0.5, 0.4), np.arange(-wide, wide + 0.1, 0.4))
        )
        c, s = np.cos(way[:, 2:]), np.sin(way[:, 2:])
        x, y = way[:, :1] + c * along - s * aside, way[:, 1:2] + s * along + c * aside
        i, j = ((y - self.terrain.y0) / PLAN).astype(int), ((x - self.terrain.x0) / PLAN).astype(int)
        passed[i, j] = True
        return passed

    # Objects

    def _add(
        self, shape: shapes.Shape, label: int, x: float, y: float, yaw: float, foot: Foot, clear: float = 0.3
    ) -> bool:
        """Put a shape there if its `foot` is free and at least `clear` m beyond the roads' edges."""
        rear, front, half = foot
        c, s = math.cos(yaw), math.sin(yaw)
        spots = ((rear, -half), (rear, half), (front, -half), (front, half), (0.5 * (rear + front), 0.0))
        if any(self.terrain.edge_at(x + c * a - s * b, y + s * a + c * b) < clear for a, b in spots):
            return False
        if not self.is_free(x, y, yaw, rear, front, half, True):
            return False
        rows = shapes.array(shape)
        out = np.empty_like(rows)
        place(rows, np.array((x, y, self.terrain.height_at(x, y), yaw)), 0.0, 1.0, out, 0)
        out[:, 15] = len(self._labels)
        self._rows.append(out)
        self._labels.append(label | (len(self._labels) + 1 & 0xFFFF) << 16)
        self.placed.append((label, x, y, yaw, foot))
        return True

    def add_vehicle(self, x: float, y: float, yaw: float, clear: float = 0.5) -> bool:
        """Park some vehicle there, if the place is free."""
        make, label = self.rng.choices(
            ((vehicles.car, 10), (vehicles.van, 10), (vehicles.truck, 18), (vehicles.bus, 13)), (80, 14, 4, 1)
        )[0]
        shape, length, width = make(self.rng)
        foot = (-0.5 * length - 0.1, 0.5 * length + 0.1, 0.5 * width + 0.05)
        return self._add(shape, label, x, y, yaw, foot, clear)

    def add_small(self, x: float, y: float) -> bool:
        """A standing person, parked bicycle or motorcycle, or clutter."""
        rng, yaw = self.rng, self.rng.uniform(0, 6.28)
        kind = rng.random()
        if kind < 0.15:
            return self._add(vehicles.bicycle(rng)[0], 11, x, y, yaw, (-0.6, 0.6, 0.2))
        if kind < 0.22:
            return self._add(vehicles.motorcycle(rng, False)[0], 15, x, y, yaw, (-0.8, 0.8, 0.3))
        return self._add(furniture.clutter(rng), 99, x, y, yaw, (-0.3, 0.3, 0.3))

    def add_standing(self, x: float, y: float) -> bool:
        """A person who stands, perhaps with others."""
        rng, done = self.rng, False
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            done |= self._add(
                people.person(rng, False)[0], 30, x + rng.gauss(0, 0.6), y + rng.gauss(0, 0.6),
                rng.uniform(0, 6.28), (-0.2, 0.2, 0.2),
            )  # fmt: skip
        return done

    def add_green(self, x: float, y: float) -> bool:
        """A tree, conifer or bush."""
        rng = self.rng
        kind = rng.random()
        if kind < 0.5:
            return self._add(plants.tree(rng), 70, x, y, rng.uniform(0, 6.28), (-0.4, 0.4, 0.4))
        if kind < 0.65:
            return self._add(plants.conifer(rng), 70, x, y, 0.0, (-1.0, 1.0, 1.0))
        return self._add(plants.bush(rng), 70, x, y, 0.0, (-1.0, 1.0, 1.0))

    def _along(self, road: Road, per_100: float) -> Iterator[float]:
        """Arc lengths at random distances, `per_100` of them in 100 m on average."""
        if per_100 <= 0:
            return
        s = self.rng.expovariate(per_100 / 100.0)
        while s < road.length:
            yield s
            s += 0.5 + self.rng.expovariate(per_100 / 100.0)

    def _fill_kerb(self, road: Road, side: int) -> None:
        rng, style = self.rng, self.style
        face = 0.0 if side < 0 else math.pi
        if road.parking:
            s = rng.uniform(0, 10)
            busy = rng.uniform(0.2, 1.0)
            while s < road.length:
                if rng.random() < busy:
                    x, y, h = road.at(s, side * (road.half - 0.5 * road.parking - rng.uniform(-0.15, 0.1)))
                    turn = face if rng.random() < 0.9 else math.pi - face
                    self.add_vehicle(x, y, h + turn + rng.gauss(0, 0.02), -road.parking - 0.3)
                s += rng.uniform(5.3, 6.8)
        elif style.parked and rng.random() < 0.3:  # in rows beside the road, nose in
            angle = rng.choice((0.5 * math.pi, 0.5 * math.pi, 1.0))
            away = road.half + self.terrain.walk + rng.uniform(2.7, 5.0)
            start = rng.uniform(0, road.length)
            for i in range(rng.randint(3, 25)):
                if rng.random() < 0.75 and start + i * 2.7 < road.length:
                    x, y, h = road.at(start + i * 2.7, side * away)
                    self.add_vehicle(x, y, h + side * angle + rng.choice((0, math.pi)), 0.3)
        line = road.half + rng.uniform(0.4, 0.9)
        for s in self._along(road, style.poles * rng.uniform(0.5, 1.5)):
            x, y, h = road.at(s, side * line)
            self._add(furniture.pole(rng), 80, x, y, h + side * 0.5 * math.pi + math.pi, (-0.1, 0.1, 0.1))
        for s in self._along(road, style.trees * rng.choice((0.0, 1.0, 2.0))):
            x, y, h = road.at(s, side * (line + rng.uniform(0, 1.5)))
            self._add(plants.tree(rng), 70, x, y, h, (-0.3, 0.3, 0.3))
        for s in self._along(road, style.standing * rng.choice((0.0, 0.5, 1.5, 3.0))):
            x, y, _ = road.at(s, side * (road.half + rng.uniform(0.3, self.terrain.walk + 2)))
            self.add_standing(x, y)
        for s in self._along(road, 0.7 * style.poles):
            x, y, _ = road.at(s, side * (road.half + rng.uniform(0.5, self.terrain.walk + 1.5)))
            self.add_small(x, y)

    def _fill_frontage(self, road: Road, side: int) -> None:
        rng, style = self.rng, self.style
        start = road.half + self.terrain.walk
        setback = rng.uniform(*style.setback)
        built, s = rng.uniform(0.6, 1.3) * style.buildings, rng.uniform(-10, 5)
        tall, ruler = rng.uniform(*style.height), rng.random()
        while s < road.length:
            wide = rng.uniform(7, 28)
            back = setback + (rng.uniform(0, 4) if ruler < 0.6 else 0.0)
            if rng.random() < built:
                deep, gap = rng.uniform(8, 15), rng.choice((0.0, 0.0, 1.0, 4.0, 8.0))
                house = max(wide - gap, 5.0)
                x, y, h = road.at(s + 0.5 * wide, side * (start + back + 0.5 * deep))
                yaw = h + (0.0 if side > 0 else math.pi) + (rng.gauss(0, 0.05) if ruler < 0.5 else 0.0)
                high = max(tall * rng.uniform(0.7, 1.3), 3.0)
                foot = (-0.5 * house, 0.5 * house, 0.5 * deep)
                self._add(furniture.building(rng, house, deep, high), 50, x, y, yaw, foot, 0.5)
            if rng.random() < style.barriers and setback > 1.0:
                x, y, h = road.at(s + 0.5 * wide, side * (start + rng.uniform(0.1, 0.6)))
                long = wide * rng.uniform(0.5, 1.0)
                shape, label = furniture.barrier(rng, long)
                self._add(shape, label, x, y, h, (-0.5 * long, 0.5 * long, 0.2), 0.3)
            for _ in range(int(rng.uniform(0, 2.5))):
                x, y, h = road.at(s + rng.uniform(0, wide), side * (start + rng.uniform(0.5, max(back, 1.0) + 3)))
                kind = rng.random()
                if kind < 0.15 and back > 5:
                    self.add_vehicle(x, y, h + rng.choice((0.5, 1.5)) * math.pi, 0.5)
                elif kind < 0.7:
                    self.add_green(x, y)
                else:
                    self.add_small(x, y)
            s += wide

    def _fill_background(self) -> None:
        """Rows of houses, woods and lines of trees behind the fronts, which close the view."""
        rng, style, road = self.rng, self.style, self.roads[0]
        closed = rng.choice((0.15, 0.5, 0.8, 0.95))
        for side in (-1, 1):
            for away in (rng.uniform(18, 35), rng.uniform(35, 60), rng.uniform(60, 80)):
                s = rng.uniform(-20, 0)
                while s < road.length:
                    wide = rng.uniform(8, 35)
                    if rng.random() < closed:
                        x, y, h = road.at(s + 0.5 * wide, side * (away + road.half + rng.uniform(-4, 4)))
                        yaw = h + (0.0 if side > 0 else math.pi) + rng.gauss(0, 0.2)
                        if rng.random() < 0.2 + 0.6 * style.buildings:
                            deep = rng.uniform(8, 15)
                            house = furniture.building(rng, wide - 2, deep, rng.uniform(*style.height))
                            self._add(house, 50, x, y, yaw, (1 - 0.5 * wide, 0.5 * wide - 1, 0.5 * deep), 3.0)
                        else:
                            self._add(plants.wood(rng, wide), 70, x, y, yaw, (-0.5 * wide, 0.5 * wide, 1.5), 3.0)
                    s += wide

    def _scatter(self) -> None:
        """What stands beyond the fronts, anywhere."""
        rng, style = self.rng, self.style
        area = self.terrain.edge.size / 1000.0
        for _ in range(int(style.green * area * rng.uniform(0.1, 1.4))):
            x, y = (
                self.terrain.x0 + rng.random() * self.terrain.edge.shape[1],
                self.terrain.y0 + rng.random() * self.terrain.edge.shape[0],
            )
            if self.terrain.edge_at(x, y) > self.terrain.walk + 2:
                self.add_green(x, y)
        for _ in range(int(area * rng.uniform(0.0, 1.0))):
            x, y = (
                self.terrain.x0 + rng.random() * self.terrain.edge.shape[1],
                self.terrain.y0 + rng.random() * self.terrain.edge.shape[0],
            )
            if self.terrain.edge_at(x, y) > self.terrain.walk + 0.5:
                rng.choice((self.add_small, self.add_standing, self.add_small))(x, y)

"""The standing world of one sequence: ground, buildings, plants, street furniture, parked cars, standing people."""

import math
from random import Random

import numpy as np

from mos_model.simulator import shapes
from mos_model.simulator.ground import COARSE, PAVED, SIDEWALK, TERRAIN, bilinear, paint_roads, pave
from mos_model.simulator.raycast import COLUMNS, place
from mos_model.simulator.roads import STYLES, Road, main_road, side_road
from runtime.jit import kernel

REACH = 85.0  # m, how far from the sensor's way the world goes


@kernel
def claim(taken, x0, y0, cell, x, y, yaw, rear, front, half, mark):
    """Whether the rectangle at (x, y, yaw) is free in the occupancy grid `taken`; if so and `mark`, take it."""
    c, s = np.cos(yaw), np.sin(yaw)
    na, nb = int((front - rear) / cell) + 1, int(2.0 * half / cell) + 1
    for turn in range(2):
        for a in range(na + 1):
            for b in range(nb + 1):
                lx, ly = rear + (front - rear) * a / na, -half + 2.0 * half * b / nb
                j, i = int((x + c * lx - s * ly - x0) / cell), int((y + s * lx + c * ly - y0) / cell)
                if i < 0 or j < 0 or i >= taken.shape[0] or j >= taken.shape[1]:
                    return False
                if turn == 0 and taken[i, j]:
                    return False
                if turn == 1:
                    taken[i, j] = True
        if not mark:
            return True
    return True


class World:
    """Everything that stands still, and the ground. Coordinates in m, z up."""

    def __init__(self, rng: Random, street: str, travel: float, crossing: float | None = None) -> None:
        """A street along which the sensor goes `travel` m, from REACH m on; with a last side road at `crossing` m,
        where it leaves the main road."""
        self.rng, self.style = rng, STYLES[street]
        self.roads = self._lay_roads(int(travel + 2 * REACH + 20), crossing, travel)
        self._shape_ground(travel, 0.0 if crossing is None else travel)
        self._taken = np.zeros((int(2 * self.edge.shape[0]), int(2 * self.edge.shape[1])), np.bool_)
        self._rows: list[np.ndarray] = []
        self._labels: list[int] = []
        self._instances = 0
        for index, road in enumerate(self.roads):
            for side in (-1, 1):
                self._furnish(road, side, index == 0)
        self._fill_background()
        self._scatter()
        self.prims = np.concatenate(self._rows) if self._rows else np.zeros((0, COLUMNS))
        self.labels = np.array(self._labels, np.uint32)

    # Roads and ground

    def _lay_roads(self, length: int, crossing: float | None, travel: float) -> list[Road]:
        rng, style = self.rng, self.style
        roads = [main_road(rng, style, length)]
        s = rng.uniform(0.2, 1.0) * style.crossings[1]
        while s < length - 20:
            if crossing is None or abs(s - crossing) > 30:
                roads.append(side_road(rng, style, roads[0], s))
            s += rng.uniform(*style.crossings)
        if crossing is not None:
            roads.append(side_road(rng, style, roads[0], crossing, 100 + int(travel)))
        return roads

    def _shape_ground(self, travel: float, aside: float) -> None:
        rng, style = self.rng, self.style
        road = self.roads[0]
        k = slice(int(REACH) - 5, int(REACH + travel) + 25)
        x, y = road.x[k], road.y[k]
        pad = REACH + 30 + aside
        self.x0, self.y0 = float(x.min()) - pad, float(y.min()) - pad
        nx, ny = int(x.max() + pad - self.x0) + 2, int(y.max() + pad - self.y0) + 2
        self.edge = np.full((ny, nx), 30.0, np.float32)
        segments = np.concatenate([r.segments() for r in self.roads])
        paint_roads(self.edge, self.x0, self.y0, COARSE, segments, 30.0)
        gx, gy = np.meshgrid(np.arange(nx), np.arange(ny))
        base = rng.gauss(0, 0.012) * gx + rng.gauss(0, 0.012) * gy
        hilly = rng.choice((0.0, 0.3, 0.8, 2.0)) if rng.random() < 0.7 else 0.0
        for _ in range(3):
            angle, wave = rng.uniform(0, 6.28), rng.uniform(60, 200)
            base = base + hilly * np.sin(
                (math.cos(angle) * gx + math.sin(angle) * gy) * (2 * math.pi / wave) + rng.uniform(0, 6.28)
            )
        noise = np.random.default_rng(rng.getrandbits(32))
        bumps = rng.choice((0.0, 0.02, 0.06)) * noise.standard_normal((ny, nx))
        base += np.where(self.edge > 3.0, bumps, 0.0)
        self.cell = 0.25 if nx * ny < 120_000 else 0.5
        shape = int(ny / self.cell), int(nx / self.cell)
        self.height, self.surface = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        self.walk, self.strip = rng.uniform(*style.walk), rng.uniform(*style.strip)
        bank = rng.gauss(0, 0.12) if rng.random() < 0.5 else 0.0
        beyond = (
            rng.choice((TERRAIN, TERRAIN, PAVED)) if style.buildings < 0.8 else rng.choice((PAVED, SIDEWALK))
        )
        kerb = rng.choice((0.0, 0.06, 0.12, 0.15)) if style.walk[1] > 2 else 0.0
        pave_style = (
            self.walk, kerb, self.strip, bank, rng.uniform(0.3, 4.0), float(rng.choice((TERRAIN, SIDEWALK))),
            float(beyond), rng.choice((0.0, 1.0)),
        )  # fmt: skip
        pave(self.height, self.surface, self.cell, self.edge, base, pave_style)
        self.highest = float(self.height.max())

    def ground_at(self, x: float, y: float) -> float:
        """Height of the ground, m."""
        return bilinear(self.height, self.x0, self.y0, self.cell, x, y)

    def edge_at(self, x: float, y: float) -> float:
        """Distance from the nearest road's edge, m; negative on a road."""
        return bilinear(self.edge, self.x0, self.y0, COARSE, x, y)

    def is_free(
        self, x: float, y: float, yaw: float, rear: float, front: float, half: float, mark: bool = False
    ) -> bool:
        """Whether nothing stands in that rectangle."""
        return claim(self._taken, self.x0, self.y0, 0.5, x, y, yaw, rear, front, half, mark)

    # Objects

    def _add(self, shape, label, x, y, yaw, foot=None, clear=0.3) -> bool:
        """Put a shape there if its `foot` (rear, front, half) is free and `clear` m beyond the road's edge."""
        if foot is not None:
            rear, front, half = foot
            if clear is not None:
                c, s = math.cos(yaw), math.sin(yaw)
                for lx, ly in (
                    (rear, -half),
                    (rear, half),
                    (front, -half),
                    (front, half),
                    (0.5 * (rear + front), 0),
                ):
                    if self.edge_at(x + c * lx - s * ly, y + s * lx + c * ly) < clear:
                        return False
            if not self.is_free(x, y, yaw, rear, front, half, True):
                return False
        self._instances += 1
        rows = shapes.array(shape)
        out = np.empty_like(rows)
        place(rows, np.array((x, y, self.ground_at(x, y), yaw)), 0.0, out, 0)
        out[:, 15] = len(self._labels)
        self._rows.append(out)
        self._labels.append(label | (self._instances & 0xFFFF) << 16)
        return True

    def add_vehicle(self, x: float, y: float, yaw: float, clear: float | None = None) -> bool:
        """Park some vehicle there, if the place is free."""
        make, label = self.rng.choices(
            ((shapes.car, 10), (shapes.van, 10), (shapes.truck, 18), (shapes.bus, 13)), (80, 14, 4, 1)
        )[0]
        shape, length, width = make(self.rng)
        foot = (-0.5 * length - 0.1, 0.5 * length + 0.1, 0.5 * width + 0.05)
        return self._add(shape, label, x, y, yaw, foot, clear)

    def add_small(self, x: float, y: float) -> bool:
        """A standing person, parked bicycle or motorcycle, or clutter."""
        rng, yaw = self.rng, self.rng.uniform(0, 6.28)
        kind = rng.random()
        if kind < 0.15:
            return self._add(shapes.bicycle(rng)[0], 11, x, y, yaw, (-0.6, 0.6, 0.2))
        if kind < 0.22:
            return self._add(shapes.motorcycle(rng, False)[0], 15, x, y, yaw, (-0.8, 0.8, 0.3))
        return self._add(shapes.clutter(rng), 99, x, y, yaw, (-0.3, 0.3, 0.3))

    def add_standing(self, x: float, y: float) -> bool:
        """A person who stands, perhaps with others."""
        rng, done = self.rng, False
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            done |= self._add(
                shapes.person(rng, False)[0], 30, x + rng.gauss(0, 0.6), y + rng.gauss(0, 0.6), rng.uniform(0, 6.28),
                (-0.2, 0.2, 0.2),
            )  # fmt: skip
        return done

    def add_green(self, x: float, y: float) -> bool:
        """A tree, conifer or bush."""
        rng = self.rng
        kind = rng.random()
        if kind < 0.5:
            return self._add(shapes.tree(rng), 70, x, y, rng.uniform(0, 6.28), (-0.4, 0.4, 0.4))
        if kind < 0.65:
            return self._add(shapes.conifer(rng), 70, x, y, 0.0, (-1.0, 1.0, 1.0))
        return self._add(shapes.bush(rng), 70, x, y, 0.0, (-1.0, 1.0, 1.0))

    def _furnish(self, road: Road, side: int, main: bool) -> None:
        self._fill_frontage(road, side)
        self._fill_kerb(road, side, main)

    def _along(self, road: Road, per_100: float):
        """Arc lengths at random distances, `per_100` of them in 100 m on average."""
        if per_100 <= 0:
            return
        s = self.rng.expovariate(per_100 / 100.0)
        while s < road.length:
            yield s
            s += 0.5 + self.rng.expovariate(per_100 / 100.0)

    def _fill_kerb(self, road: Road, side: int, main: bool) -> None:
        rng, style = self.rng, self.style
        face = 0.0 if side < 0 else math.pi
        if road.parking:
            s = rng.uniform(0, 10)
            busy = rng.uniform(0.2, 1.0)
            while s < road.length:
                if rng.random() < busy:
                    x, y, h = road.at(s, side * (road.half - 0.5 * road.parking - rng.uniform(-0.15, 0.1)))
                    self.add_vehicle(
                        x, y, h + (face if rng.random() < 0.9 else math.pi - face) + rng.gauss(0, 0.02)
                    )
                s += rng.uniform(5.3, 6.8)
        elif style.parked and rng.random() < 0.3:  # in rows beside the road, nose in
            angle = rng.choice((0.5 * math.pi, 0.5 * math.pi, 1.0))
            away = road.half + self.walk + rng.uniform(2.7, 5.0)
            start = rng.uniform(0, road.length)
            for i in range(rng.randint(3, 25)):
                if rng.random() < 0.75 and start + i * 2.7 < road.length:
                    x, y, h = road.at(start + i * 2.7, side * away)
                    self.add_vehicle(x, y, h + side * angle + rng.choice((0, math.pi)), 0.3)
        line = road.half + rng.uniform(0.4, 0.9)
        for s in self._along(road, style.poles * rng.uniform(0.5, 1.5)):
            x, y, h = road.at(s, side * line)
            self._add(shapes.pole(rng), 80, x, y, h + side * 0.5 * math.pi + math.pi, (-0.1, 0.1, 0.1))
        for s in self._along(road, style.trees * rng.choice((0.0, 1.0, 2.0))):
            x, y, h = road.at(s, side * (line + rng.uniform(0, 1.5)))
            self._add(shapes.tree(rng), 70, x, y, h, (-0.3, 0.3, 0.3))
        for s in self._along(road, style.standing * rng.choice((0.0, 0.5, 1.5, 3.0))):
            x, y, _ = road.at(s, side * (road.half + rng.uniform(0.3, self.walk + 2)))
            self.add_standing(x, y)
        for s in self._along(road, 0.7 * style.poles):
            x, y, _ = road.at(s, side * (road.half + rng.uniform(0.5, self.walk + 1.5)))
            self.add_small(x, y)

    def _fill_frontage(self, road: Road, side: int) -> None:
        rng, style = self.rng, self.style
        start = road.half + self.walk
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
                self._add(shapes.building(rng, house, deep, high), 50, x, y, yaw, foot, 0.5)
            if rng.random() < style.barriers and setback > 1.0:
                x, y, h = road.at(s + 0.5 * wide, side * (start + rng.uniform(0.1, 0.6)))
                long = wide * rng.uniform(0.5, 1.0)
                shape, label = shapes.barrier(rng, long)
                self._add(shape, label, x, y, h, (-0.5 * long, 0.5 * long, 0.2), 0.3)
            for _ in range(int(rng.uniform(0, 2.5))):
                x, y, h = road.at(
                    s + rng.uniform(0, wide), side * (start + rng.uniform(0.5, max(back, 1.0) + 3))
                )
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
                            house = shapes.building(rng, wide - 2, deep, rng.uniform(*style.height))
                            self._add(house, 50, x, y, yaw, (1 - 0.5 * wide, 0.5 * wide - 1, 0.5 * deep), 3.0)
                        else:
                            self._add(
                                shapes.wood(rng, wide), 70, x, y, yaw, (-0.5 * wide, 0.5 * wide, 1.5), 3.0
                            )
                    s += wide

    def _scatter(self) -> None:
        """What stands beyond the fronts, anywhere."""
        rng, style = self.rng, self.style
        area = self.edge.size / 1000.0
        for _ in range(int(style.green * area * rng.uniform(0.1, 1.4))):
            x, y = self.x0 + rng.random() * self.edge.shape[1], self.y0 + rng.random() * self.edge.shape[0]
            if self.edge_at(x, y) > self.walk + 2:
                self.add_green(x, y)
        for _ in range(int(area * rng.uniform(0.0, 1.0))):
            x, y = self.x0 + rng.random() * self.edge.shape[1], self.y0 + rng.random() * self.edge.shape[0]
            if self.edge_at(x, y) > self.walk + 0.5:
                rng.choice((self.add_small, self.add_standing, self.add_small))(x, y)

"""Rooms, corridors and halls with what stands in them: the world of a sequence that is indoors."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

import numpy as np

from mos_model.simulator import furniture, interiors, pedestrians, plants, shapes
from mos_model.simulator.ground import PAVED, SIDEWALK
from mos_model.simulator.interiors import WALL, Foot, Piece
from mos_model.simulator.placing import claim, place
from mos_model.simulator.raycast import MATT, MESH, METAL
from mos_model.simulator.shapes import box

CELL = 0.1  # m, of the floor plan
PERSON = 30
Place = tuple[float, float, float]  # m and radians: x, y, yaw


@dataclass(frozen=True)
class RoomStyle:
    """What a kind of room looks like; ranges are (least, greatest)."""

    length: tuple[float, float]  # m
    width: tuple[float, float]  # m
    height: tuple[float, float]  # m
    free: tuple[Callable[[Random], Piece], ...]  # what stands anywhere
    side: tuple[Callable[[Random], Piece], ...]  # what stands along the walls
    crowded: float  # things to a square metre, at most
    people: float  # that walk, at most


ROOM_STYLES = {
    "room": RoomStyle((3.5, 12), (2.8, 9), (2.4, 3.6), interiors.FREE, interiors.SIDE, 0.35, 4),
    "corridor": RoomStyle((10, 60), (1.4, 4), (2.4, 4), (interiors.boxes, interiors.plant), interiors.SIDE, 0.05, 7),
    "hall": RoomStyle((15, 60), (10, 40), (3.5, 12), interiors.LARGE, interiors.LARGE, 0.06, 14),
}


class Floor:
    """Level ground, as `Terrain` has it, `reach` m around the origin."""

    walk = 2.0  # m

    def __init__(self, rng: Random, reach: float) -> None:
        self.x0 = self.y0 = -reach
        self.cell, self.highest = 0.5, 0.0
        count = int(2 * reach / self.cell) + 2
        self.height = np.zeros((count, count), np.float32)
        self.surface = np.full((count, count), PAVED, np.uint8)
        for _ in range(rng.choice((0, 0, 1, 3))):  # carpets, or another floor
            i, j, n = rng.randrange(count), rng.randrange(count), rng.randint(3, 20)
            self.surface[i : i + n, j : j + n] = SIDEWALK

    def height_at(self, x: float, y: float) -> float:
        """Height of the ground, m."""
        return 0.0

    def heights_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights (n,) of the ground, m."""
        return np.zeros(len(x))


class Room:
    """Walls with doors and windows, ceiling, furniture. Built along its own axes, x along its length; the origin is in
    the middle of the floor."""

    def __init__(self, rng: Random, kind: str) -> None:
        self.rng, self.style = rng, ROOM_STYLES[kind]
        a, b = (rng.uniform(*limits) ** rng.choice((1, 1, 0.8)) for limits in (self.style.length, self.style.width))
        self.length, self.width = max(a, b), min(a, b)
        self.height = rng.uniform(*self.style.height)
        self.garage = kind == "hall" and rng.random() < 0.25
        if self.garage:
            self.height = rng.uniform(2.3, 3.2)
        self.terrain = Floor(rng, 0.5 * math.hypot(self.length, self.width) + 40)
        self._plan = np.zeros((int(self.width / CELL) + 1, int(self.length / CELL) + 1), np.bool_)
        self._rows: list[np.ndarray] = []
        self._labels: list[int] = []
        self.doors: list[tuple[Place, float, float]] = []  # hinge and direction of closed ones, width and height
        self._tone = rng.uniform(0.3, 0.85)
        self._build()

    @property
    def prims(self) -> np.ndarray:
        """All that stands (n, COLUMNS)."""
        return np.concatenate(self._rows)

    @property
    def labels(self) -> np.ndarray:
        """(objects,) uint32."""
        return np.array(self._labels, np.uint32)

    def is_free(self, at: Place, foot: Foot, mark: bool = False) -> bool:
        """Whether nothing stands in that rectangle; `mark` takes it if so."""
        x, y, yaw = at
        free: bool = claim(self._plan, -0.5 * self.length, -0.5 * self.width, CELL, x, y, yaw, *foot, mark)
        return free

    def keep_free(self, way: np.ndarray, half: float) -> None:
        """Nothing will stand within `half` m of the points (n, 2)."""
        for x, y in way.tolist():
            j0, j1 = (int((x + d + 0.5 * self.length) / CELL) for d in (-half, half))
            i0, i1 = (int((y + d + 0.5 * self.width) / CELL) for d in (-half, half))
            self._plan[max(i0, 0) : i1 + 1, max(j0, 0) : j1 + 1] = True

    def add(self, shape: shapes.Shape, label: int, at: Place) -> None:
        """Put a shape there."""
        rows = shapes.array(shape)
        out = np.empty_like(rows)
        place(rows, np.array((at[0], at[1], 0.0, at[2])), 0.0, 0.0, out, 0)
        out[:, 15] = len(self._labels)
        self._rows.append(out)
        self._labels.append(label | (len(self._labels) + 1 & 0xFFFF) << 16)

    def _sides(self) -> list[tuple[Place, float]]:
        """Middle of each wall, looking inwards, and its length."""
        x, y = 0.5 * self.length, 0.5 * self.width
        return [
            ((-x, 0.0, 0.0), self.width), ((x, 0.0, math.pi), self.width),
            ((0.0, -y, 0.5 * math.pi), self.length), ((0.0, y, -0.5 * math.pi), self.length),
        ]  # fmt: skip

    def _build(self) -> None:
        rng, high = self.rng, self.height
        outside = rng.random() < 0.6
        for side, long in self._sides():
            self._wall(side, long, outside and rng.random() < 0.6)
        x, y = 0.5 * self.length + 0.3, 0.5 * self.width + 0.3
        ceiling = [box(-x, x, y, high, high + 0.3, MATT, rng.uniform(0.4, 0.9))]
        if rng.random() < 0.5:
            for _ in range(rng.randint(1, 12)):  # lamps, beams and ducts
                u, v = rng.uniform(-0.9, 0.9) * x, rng.uniform(-0.9, 0.9) * y
                long, wide, deep = rng.uniform(0.1, 1.2), rng.uniform(0.1, 0.5), rng.uniform(0.05, 0.1 * high)
                ceiling.append(box(u - long, u + long, wide, high - deep, high, MATT, 0.6, at=(0, v, 0)))
        if rng.random() < 0.3:
            step = rng.uniform(1.5, 5.0)
            ceiling += [
                box(u - 0.1, u + 0.1, y - 0.3, high - 0.1 * high, high, METAL, 0.4)
                for u in np.arange(-x + step, x, step).tolist()
            ]
        self.add(ceiling, WALL, (0.0, 0.0, 0.0))
        if outside:
            for _ in range(rng.randint(2, 6)):
                angle, away = (
                    rng.uniform(-math.pi, math.pi),
                    0.5 * math.hypot(self.length, self.width) + rng.uniform(9, 25),
                )
                at = (away * math.cos(angle), away * math.sin(angle), angle + 0.5 * math.pi)
                if rng.random() < 0.5:
                    self.add(plants.tree(rng), interiors.PLANT, at)
                else:
                    self.add(furniture.building(rng, rng.uniform(8, 25), 6, rng.uniform(4, 15)), WALL, at)

    def _wall(self, side: Place, long: float, outer: bool) -> None:
        """A wall with doors and, in an `outer` one, windows."""
        rng, thick, tops = self.rng, self.rng.uniform(0.1, 0.3), min(self.height, 2.6)
        c, s = math.cos(side[2]), math.sin(side[2])
        shape, u, end = [], -0.5 * long - thick, 0.5 * long + thick

        def slab(a: float, b: float, low: float, top: float) -> None:
            shape.append(box(-thick, 0.0, 0.5 * (b - a), low, top, MATT, self._tone, at=(0, 0.5 * (a + b), 0)))

        at = -0.5 * long + rng.uniform(0.3, 3.0)
        while at < 0.5 * long - 1.3:
            kind, wide = rng.random(), rng.uniform(0.8, 1.1)
            if kind < 0.5 and outer:
                wide = min(rng.uniform(0.6, 3.0), 0.5 * long - 0.2 - at)
                low, top = rng.choice((rng.uniform(0.7, 1.1), 0.1)), rng.uniform(0.8, 0.95) * tops
                slab(u, at, 0.0, self.height)
                slab(at, at + wide, 0.0, low)
                slab(at, at + wide, top, self.height)
                pane = rng.choice((0.05, 0.15, 0.5, 0.9))
                middle = (0.0, at + 0.5 * wide, 0.0)
                shape.append(box(-0.06, -0.05, 0.5 * wide, low, top, MESH, 0.2, at=middle, p=(pane, 0, 0)))
                shape.append(box(-0.08, -0.03, 0.03, low, top, MATT, 0.6, at=middle))
            elif kind < 0.7:
                tall = min(rng.uniform(1.95, 2.15), self.height - 0.1)
                slab(u, at, 0.0, self.height)
                slab(at, at + wide, tall, self.height)
                hinge = (side[0] - s * at, side[1] + c * at, side[2] + 0.5 * math.pi)
                self.doors.append((hinge, wide, tall))
                self._annex(side, at, wide, thick)
            else:
                at += rng.uniform(1.0, 5.0)
                continue
            u = at + wide
            at = u + rng.uniform(0.3, 4.0)
        slab(u, end, 0.0, self.height)
        self.add(shape, WALL, side)

    def _annex(self, side: Place, at: float, wide: float, thick: float) -> None:
        """What is behind a door: another closed room, as deep as one sees into it."""
        rng, deep, high = self.rng, self.rng.uniform(1.5, 8.0), self.rng.uniform(2.3, 2.8)
        left, right = at - rng.uniform(0.3, 2.5), at + wide + rng.uniform(0.3, 2.5)
        middle, half, rear = 0.5 * (left + right), 0.5 * (right - left), -thick - deep
        shape = [
            box(rear - 0.1, rear, half, 0.0, high, MATT, self._tone, at=(0, middle, 0)),
            box(rear, -thick, half, high, high + 0.2, MATT, 0.7, at=(0, middle, 0)),
            *(box(rear, -thick, 0.05, 0.0, high, MATT, self._tone, at=(0, y, 0)) for y in (left, right)),
        ]
        self.add(shape, WALL, side)

    def turn(self, turn: np.ndarray) -> None:
        """Turn all that stands about the origin; `turn` (2, 2) multiplies rows of x, y."""
        for rows in self._rows:
            rows[:, 1:3] = rows[:, 1:3] @ turn
            rows[:, 4:6] = rows[:, 4:6] @ turn

    def furnish(self) -> None:
        """Fill what is free."""
        rng, style = self.rng, self.style
        full = rng.choice((0.1, 0.5, 1.0, 1.0)) * style.crowded
        if self.length > 12 and rng.random() < 0.5:
            self._columns()
        for side, long in self._sides():
            for _ in range(int(long * rng.uniform(0.0, 0.7))):
                shape, foot, label = (
                    interiors.fixture(rng, self.height) if rng.random() < 0.25 else rng.choice(style.side)(rng)
                )
                self._put(shape, foot, label, self._beside(side, rng.uniform(-0.5, 0.5) * long, 0.03 - foot[0]))
        for _ in range(min(int(full * self.length * self.width), 90)):
            piece = interiors.parked(rng) if self.garage else rng.choice(style.free)(rng)
            at = rng.uniform(-0.5, 0.5) * self.length, rng.uniform(-0.5, 0.5) * self.width
            turn = rng.choice((0, 0.5, 1, 1.5)) * math.pi + rng.choice((0.0, rng.gauss(0, 0.3)))
            if self._put(*piece, (*at, turn)) and piece[1][2] > 0.3 and style.free is interiors.FREE:
                self._seats((*at, turn), piece[1])

    def _beside(self, side: Place, along: float, away: float) -> Place:
        c, s = math.cos(side[2]), math.sin(side[2])
        return side[0] + c * away - s * along, side[1] + s * away + c * along, side[2]

    def _columns(self) -> None:
        rng, gap = self.rng, self.rng.uniform(4, 9)
        shape, foot, label = interiors.column(rng)
        for x in np.arange(-0.5 * self.length + gap, 0.5 * self.length - 1, gap).tolist():
            for y in np.arange(-0.5 * self.width + gap, 0.5 * self.width - 1, gap).tolist():
                self._put(shape, foot, label, (x, y, 0.0))

    def _seats(self, at: Place, foot: Foot) -> None:
        """Chairs around a table, some taken."""
        rng = self.rng
        for side in (-1, 1):
            if rng.random() < 0.6:
                away = foot[1] + rng.uniform(0.05, 0.4)
                spot = self._beside(at, rng.uniform(-0.5, 0.5) * foot[2], side * away)
                self._seat((spot[0], spot[1], at[2] + (math.pi if side > 0 else 0.0) + rng.gauss(0, 0.2)))

    def _seat(self, at: Place) -> None:
        shape, foot, label = interiors.chair(self.rng)
        if self._put(shape, foot, label, at) and self.rng.random() < 0.35:
            self.add(pedestrians.sitting(self.rng), PERSON, at)

    def _put(self, shape: shapes.Shape, foot: Foot, label: int, at: Place) -> bool:
        if not self.is_free(at, foot, True):
            return False
        self.add(shape, label, at)
        return True

"""Roads: centre lines sampled every metre, their cross-section, and paths along their lanes."""

import math
from dataclasses import dataclass
from random import Random

import numpy as np


@dataclass(frozen=True)
class StreetStyle:
    """What a kind of street looks like; ranges are (least, greatest), chances 0..1."""

    lanes: tuple[int, ...]  # per direction, drawn from these
    lane_width: tuple[float, float]  # m
    speed: tuple[float, float]  # m/s, of the traffic
    crossings: tuple[float, float]  # m between side roads
    bend: float  # 1/m, standard deviation of the curvature
    walk: tuple[float, float]  # m, sidewalk
    strip: tuple[float, float]  # m, strip beyond
    parked: float  # share of the kerb with parked cars
    buildings: float  # share of the frontage that is built up
    setback: tuple[float, float]  # m, sidewalk to buildings
    height: tuple[float, float]  # m, of buildings
    barriers: float  # share of the frontage with hedge, wall, fence or rail
    trees: float  # per 100 m of kerb
    poles: float  # per 100 m of kerb
    green: float  # trees and bushes per 1000 m2 beyond
    vehicles: float  # per lane and 100 m
    walkers: float  # per 100 m of street
    standing: float  # people standing, per 100 m of street


STYLES = {
    "residential": StreetStyle((1,), (2.6, 3.4), (5, 13), (50, 160), 0.006, (1.2, 2.5), (0, 3), 0.55, 0.6, (0.5, 8),
                               (5, 12), 0.55, 2.0, 2.0, 3.0, 0.7, 2.0, 0.8),
    "urban": StreetStyle((1, 1, 2), (2.8, 3.6), (6, 15), (50, 150), 0.003, (2, 6), (0, 2), 0.5, 0.85, (0, 3),
                         (9, 25), 0.15, 3.0, 5.0, 0.5, 1.3, 4.5, 2.0),
    "highway": StreetStyle((2, 2, 3), (3.4, 3.8), (20, 34), (400, 900), 0.0008, (0.2, 1.5), (2, 8), 0.0, 0.05, (10, 40),
                           (6, 15), 0.85, 1.0, 2.0, 5.0, 1.4, 0.02, 0.02),
    "country": StreetStyle((1,), (2.7, 3.6), (10, 24), (150, 500), 0.004, (0.2, 1.5), (2, 8), 0.02, 0.12, (5, 25),
                           (4, 10), 0.3, 2.5, 1.0, 5.0, 0.7, 0.3, 0.1),
    "open": StreetStyle((1, 2), (3.0, 4.0), (3, 14), (60, 200), 0.004, (1, 4), (2, 15), 0.15, 0.25, (10, 35),
                        (5, 20), 0.1, 1.0, 1.5, 0.6, 0.7, 2.0, 0.7),
}  # fmt: skip


@dataclass
class Road:
    """A centre line: x, y in m and heading in radians every metre; lanes of one direction lie to the right of it."""

    x: np.ndarray  # (n,)
    y: np.ndarray  # (n,)
    heading: np.ndarray  # (n,)
    lanes: int  # per direction
    lane_width: float
    parking: float  # m, parking strip on both sides, inside the road's edge

    @property
    def length(self) -> float:
        """Length in m."""
        return float(len(self.x) - 1)

    @property
    def half(self) -> float:
        """Half width, kerb to kerb, m."""
        return self.lanes * self.lane_width + self.parking

    def at(self, s: float, aside: float) -> tuple[float, float, float]:
        """x, y, heading at arc length s, `aside` m to the left."""
        i = min(max(int(s), 0), len(self.x) - 2)
        f = s - i
        h = float(self.heading[i])
        x = float(self.x[i]) + f * (float(self.x[i + 1]) - float(self.x[i])) - aside * math.sin(h)
        y = float(self.y[i]) + f * (float(self.y[i + 1]) - float(self.y[i])) + aside * math.cos(h)
        return x, y, h

    def line(self, aside: float, start: float = 0.0, stop: float | None = None) -> np.ndarray:
        """Points (n, 2) every metre from `start` to `stop`, `aside` m to the left; backwards where stop < start."""
        stop = self.length if stop is None else stop
        s = np.linspace(start, stop, max(int(abs(stop - start)), 1) + 1)
        k = np.arange(len(self.x))
        h = np.interp(s, k, self.heading)
        x, y = np.interp(s, k, self.x), np.interp(s, k, self.y)
        return np.stack([x - aside * np.sin(h), y + aside * np.cos(h)], 1)

    def segments(self) -> np.ndarray:
        """(m, 5) two ends and half width of straight pieces, for painting."""
        bend = np.abs(np.diff(self.heading)).max(initial=0.0)
        step = 2 if bend > 0.02 else 5
        k = np.append(np.arange(0, len(self.x) - 1, step), len(self.x) - 1)
        ends = np.stack([self.x[k], self.y[k]], 1)
        return np.column_stack([ends[:-1], ends[1:], np.full(len(k) - 1, self.half)])


def main_road(rng: Random, style: StreetStyle, length: int) -> Road:
    """The road that the sensor drives on, starting at the origin."""
    noise = np.random.default_rng(rng.getrandbits(32))
    curvature = np.convolve(noise.normal(0, style.bend, length // 10 + 6), np.ones(4) / 2.0, "same")
    curvature = np.interp(np.arange(length + 1), 10.0 * np.arange(len(curvature)), curvature)
    if rng.random() < 0.3:
        curvature[:] = 0.0
    elif style.bend > 0.0025 and rng.random() < 0.35:  # a sharp bend
        at, radius, angle = rng.uniform(0.3, 0.7) * length, rng.uniform(9, 30), rng.uniform(0.4, 1.6)
        n = int(max(radius * angle, 4))
        curvature[int(at) : int(at) + n] = rng.choice((-1, 1)) * angle / n
    heading = rng.uniform(0, 2 * math.pi) + np.concatenate([[0.0], np.cumsum(curvature[:-1])])
    x = np.concatenate([[0.0], np.cumsum(np.cos(heading[:-1]))])
    y = np.concatenate([[0.0], np.cumsum(np.sin(heading[:-1]))])
    parking = rng.uniform(1.9, 2.4) if rng.random() < 1.4 * style.parked else 0.0
    return Road(x, y, heading, rng.choice(style.lanes), rng.uniform(*style.lane_width), parking)


def side_road(rng: Random, style: StreetStyle, road: Road, s: float, reach: int = 100) -> Road:
    """A straight road across `road` at s, or one that ends there."""
    x, y, h = road.at(s, 0.0)
    h += rng.choice((-1, 1)) * rng.gauss(0.5 * math.pi, 0.2)
    before, after = (reach, reach) if rng.random() < 0.6 else (reach, 0)
    k = np.arange(-before, after + 1)
    parking = rng.uniform(1.9, 2.4) if rng.random() < style.parked else 0.0
    lanes = rng.choice((1, 1, road.lanes))
    return Road(
        x + k * math.cos(h),
        y + k * math.sin(h),
        np.full(len(k), h),
        lanes,
        rng.uniform(*style.lane_width),
        parking,
    )


def turning_path(first: np.ndarray, second: np.ndarray, sharp: float) -> np.ndarray:
    """Join two lines (n, 2) with a smooth curve where they come nearest; it leaves `sharp` m before that point."""
    gap = ((first[:, None] - second[None]) ** 2).sum(2)
    i, j = np.unravel_index(gap.argmin(), gap.shape)
    i, j = max(int(i) - int(sharp), 1), min(int(j) + int(sharp), len(second) - 2)
    a, b = first[i], second[j]
    reach = 1.2 * np.linalg.norm(b - a)
    ta, tb = first[i] - first[i - 1], second[j + 1] - second[j]
    ta, tb = ta / (np.linalg.norm(ta) + 1e-9) * reach, tb / (np.linalg.norm(tb) + 1e-9) * reach
    u = np.linspace(0, 1, 2 * int(sharp) + 3)[1:-1, None]
    curve = (
        (2 * u**3 - 3 * u**2 + 1) * a
        + (u**3 - 2 * u**2 + u) * ta
        + (3 * u**2 - 2 * u**3) * b
        + (u**3 - u**2) * tb
    )
    return np.concatenate([first[: i + 1], curve, second[j:]])

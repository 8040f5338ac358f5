"""Roads: centre lines sampled every metre, and paths along their lanes."""

import math
from dataclasses import dataclass
from random import Random

import numpy as np

from mos_model.simulator.streets import StreetStyle


@dataclass
class Road:
    """A centre line: x, y in m and heading in radians every metre; traffic keeps to the right of it."""

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
        """Points (n, 2) each metre from `start` to `stop` (or back), `aside` m to the left."""
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


def lay_roads(rng: Random, style: StreetStyle, length: int, crossing: float | None, beyond: float) -> list[Road]:
    """The main road, `length` m long, and its side roads; the last of them at `crossing` m, where the sensor
    leaves the main road and goes at most `beyond` m further."""
    roads = [main_road(rng, style, length)]
    s = rng.uniform(0.2, 1.0) * style.crossings[1]
    while s < length - 20:
        if crossing is None or abs(s - crossing) > 30:
            roads.append(side_road(rng, style, roads[0], s))
        s += rng.uniform(*style.crossings)
    if crossing is not None:
        roads.append(side_road(rng, style, roads[0], crossing, 100 + int(beyond)))
    return roads


def turning_path(first: np.ndarray, second: np.ndarray, sharp: float) -> np.ndarray:
    """Join two lines (n, 2) by a smooth curve where they come nearest; it leaves `sharp` m before that point."""
    gap = ((first[:, None] - second[None]) ** 2).sum(2)
    i, j = np.unravel_index(gap.argmin(), gap.shape)
    i, j = max(int(i) - int(sharp), 1), min(int(j) + int(sharp), len(second) - 2)
    a, b = first[i], second[j]
    reach = 1.2 * np.linalg.norm(b - a)
    ta, tb = first[i] - first[i - 1], second[j + 1] - second[j]
    ta, tb = ta / (np.linalg.norm(ta) + 1e-9) * reach, tb / (np.linalg.norm(tb) + 1e-9) * reach
    u = np.linspace(0, 1, 2 * int(sharp) + 3)[1:-1, None]
    curve = (2 * u**3 - 3 * u**2 + 1) * a + (u**3 - 2 * u**2 + u) * ta + (3 * u**2 - 2 * u**3) * b + (u**3 - u**2) * tb
    return _rounded(np.concatenate([first[: i + 1], curve, second[j:]]))


def _rounded(line: np.ndarray, spacing: float = 1.0, passes: int = 12) -> np.ndarray:
    """The line with points `spacing` m apart and its kinks spread over some metres, as a car would drive it."""
    walked = np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T).cumsum()])
    at = np.linspace(0.0, walked[-1], int(walked[-1] / spacing) + 2)
    even = np.stack([np.interp(at, walked, line[:, k]) for k in range(2)], 1)
    for _ in range(passes):
        even[1:-1] = 0.25 * even[:-2] + 0.5 * even[1:-1] + 0.25 * even[2:]
    return even

"""Motion along a path: a line of points, a speed over time, and the states that follow from both."""

from random import Random

import numpy as np

STEP = 0.02  # s, integration step of the speed profiles


class Path:
    """A line of points (n, 2) in m, walked by arc length."""

    def __init__(self, points: np.ndarray) -> None:
        gap = np.hypot(*np.diff(points, axis=0).T)
        keep = np.concatenate([[True], gap > 1e-3])
        self.points = points[keep]
        self.s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.points, axis=0).T))])
        heading = np.unwrap(np.arctan2(*np.diff(self.points, axis=0).T[::-1]))
        self.middle, self.heading = 0.5 * (self.s[1:] + self.s[:-1]), heading

    @property
    def length(self) -> float:
        """Length in m."""
        return float(self.s[-1])

    def bend(self, start: float, stop: float) -> float:
        """The strongest curvature between two arc lengths, 1/m, over stretches of 3 m."""
        yaw = np.interp(np.arange(start, max(stop, start + 1.0) + 3.0), self.middle, self.heading)
        return float(np.abs(yaw[3:] - yaw[:-3]).max()) / 3.0

    def at(self, s: np.ndarray) -> np.ndarray:
        """(n, 3) x, y, yaw at arc lengths s; straight on beyond the ends."""
        x, y = np.interp(s, self.s, self.points[:, 0]), np.interp(s, self.s, self.points[:, 1])
        yaw = np.interp(s, self.middle, self.heading)
        over = np.maximum(s - self.s[-1], 0.0) + np.minimum(s, 0.0)
        return np.stack([x + over * np.cos(yaw), y + over * np.sin(yaw), yaw], 1)


class Speed:
    """Speed over time; knows the distance walked since time 0. Times from -1 s to `duration` + 1 s."""

    def __init__(self, duration: float, speed: np.ndarray, times: np.ndarray) -> None:
        self.duration = duration
        self.times = np.arange(-1.0, duration + 1.0, STEP)
        self.speed = np.interp(self.times, times, speed)
        walked = np.concatenate([[0.0], np.cumsum(0.5 * (self.speed[1:] + self.speed[:-1])) * STEP])
        self.walked = walked - np.interp(0.0, self.times, walked)

    def slowed(self, factor: float) -> "Speed":
        """The same profile, `factor` times as fast."""
        return Speed(self.duration, factor * self.speed, self.times)

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance and speed at times t."""
        return np.interp(t, self.times, self.walked), np.interp(t, self.times, self.speed)


def draw_speed(rng: Random, kind: str, fast: float, duration: float, hard: float = 2.5) -> Speed:
    """A speed profile around `fast` m/s: constant, standing, pull_away, brake or stop_and_go.

    `hard` is the strongest push in m/s2.
    """
    end = duration + 1.0
    push = rng.uniform(0.4, 1.0) * hard
    if kind == "standing":
        times, speed = [-1.0, end], [0.0, 0.0]
    elif kind == "pull_away":
        go = rng.uniform(-0.5, 0.8 * duration)
        times, speed = [-1.0, go, go + fast / push, end + 60], [0.0, 0.0, fast, fast]
    elif kind == "brake":
        stop = rng.uniform(0.0, duration)
        times, speed = [-60.0, stop - fast / push, stop, end + 60], [fast, fast, 0.0, 0.0]
    elif kind == "stop_and_go":
        times, speed, t, now = [-1.0], [rng.choice((0.0, fast))], -1.0, 0.0
        while t < end:
            now = rng.choice((0.0, 0.0, rng.uniform(0.2, 1.0) * fast))
            t += abs(now - speed[-1]) / push + 0.05
            times.append(t)
            speed.append(now)
            t += rng.uniform(0.5, 3.0)
            times.append(t)
            speed.append(now)
    else:
        swing = 0.0 if rng.random() < 0.4 else rng.uniform(-0.25, 0.25) * fast
        times, speed = [-1.0, end], [fast - swing, fast + swing]
    return Speed(duration, np.array(speed), np.array(times))

"""People who go where they find room: alone, or some side by side."""

import math
from random import Random

import numpy as np

from mos_model.simulator import shapes
from mos_model.simulator.boxes import bounds
from mos_model.simulator.motion import STEP, Path, Speed, draw_speed
from mos_model.simulator.pedestrians import Figure, pedestrian
from mos_model.simulator.placing import clearance
from mos_model.simulator.terrain import Ground
from mos_model.simulator.traffic import PERSON, Track, in_view

WALK = 1.2  # m/s, who goes slower takes shorter steps
BODY = 0.22  # m, from the middle of somebody to what stands beside


class Walkers:
    """Draws people among what stands."""

    indoors = True

    def __init__(self, rng: Random, prims: np.ndarray, terrain: Ground, times: np.ndarray, ego: np.ndarray) -> None:
        """`prims` (n, COLUMNS) of what stands; `times` (frames,) s; `ego` (frames, 3) x, y, yaw of the sensor."""
        self.rng, self.prims, self.terrain, self.ego = rng, prims, terrain, ego
        self.times, self.duration = times, float(times[-1])
        self.boxes = bounds(prims)
        self.tracks: list[Track] = []

    def group(self, x: float, y: float, yaw: float, most: int = 6, usual: float = 1.3) -> bool:
        """One, or some side by side, whose way leads through there: whether anybody found room."""
        rng = self.rng
        runs = usual > WALK and rng.random() < 0.09
        fast = rng.uniform(2.2, 4.0) if runs else min(max(rng.gauss(usual, 0.25), 0.4), 2.0)
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
            found |= self.walk(Path(line), 1.0, speed, pedestrian(rng, runs, child, self.indoors))
        return found

    def walk(self, path: Path, start: float, speed: Speed, figure: Figure, gap: float = 0.1, turn: float = 0.0) -> bool:
        """Add somebody who starts at `start` m of `path`, turning on the spot by `turn` radians/s, if nothing stands
        within `gap` m of the body on all of that way."""
        states = gait(path, start, speed, figure, self.times, turn)
        if not in_view(states, self.ego):
            return False
        steps = np.unique(np.linspace(0, len(states) - 1, 2 + int(2 * np.ptp(states[:, 4]))).astype(int))
        spots = np.column_stack([states[steps, :2], self.terrain.heights_at(*states[steps, :2].T)])
        if clearance(self.prims, self.boxes, spots) < BODY + gap:
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

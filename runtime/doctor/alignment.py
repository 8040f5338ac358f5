"""Do poses fit their scans? Static surroundings of two scans must fall together once they are applied."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from runtime.doctor.findings import Finding
from runtime.doctor.landmarks import REACH, Motion, Points, View

LAGS = (1, 3, 8)  # scans between the two: the first shows errors of fast drives, the last those of slow ones
SUSPECT = {1: 0.15, 3: 0.18, 8: 0.22}  # m, by lag: below, no better motion is looked for; of right poses 90 % are
AGAIN = 1.25  # times a misfit for which no better motion was found, from which on one is looked for again
CERTAIN = 0.35  # m, misfit from which one is looked for anyway: of right poses 99 % are below
HOPELESS = 2.0  # times the lower misfit: from there no search starts
STRIDES = (0.8, 0.4, 0.2, 0.1, 0.05)  # m by which motions are varied in search of a better one
ROUNDS = 3  # with each of them, at most
LEVER = 15.0  # m at which a turn by one stride is one long
FAR_POINT = 10.0  # m, distance of the point by whose motion two motions are compared

BETTER = 0.6  # share of the misfit that a better motion leaves, if it is believed: of 1,800 right pairs, 4 had one
OFF = {1: 0.2, 3: 0.25, 8: 0.3}  # m between the two, by lag: wrong poses are off by more each scan, poor ones hardly
WITNESSES = 2  # pairs of scans of one lag, at least, and more than half of them


@dataclass(frozen=True)
class Fit:
    """Static surroundings of a past scan under the motion that the poses give, and under the best that was found."""

    lag: int  # scans between the two
    given: float  # m, see `View.misfit`, under the given motion; NaN: too little in sight
    best: float  # m, under the best motion
    moves: float  # m of the given motion
    should: float  # m of the best motion
    off: float  # m by which a point 10 m away is moved elsewhere by the one than by the other

    @property
    def wrong(self) -> bool:
        """Another motion fits far better."""
        return self.best < BETTER * self.given and self.off > OFF[self.lag]


def fit(view: View, landmarks: Points, motion: Motion, lag: int, before: Sequence[Fit] = ()) -> Fit:
    """Compare the given T_current_past with the best one near it, or near no motion at all.

    before: fits of the same recording. Where they found no better motion, none is looked for until the misfit rises.

    The search is in the plane of the sensor (forward, left, turn): enough to see that another motion fits far better.
    """
    given = view.misfit(landmarks, motion)
    if not given > suspicion(before, lag):  # nor NaN
        return Fit(lag, given, given, length(motion), length(motion), 0.0)
    still = view.misfit(landmarks, np.eye(4))
    starts = [(given, motion), (still, np.eye(4))]
    hopeful = [start for start in starts if start[0] <= HOPELESS * min(given, still)]
    best, found = min((_search(view, landmarks, *start) for start in hopeful), key=lambda pair: pair[0])
    return Fit(lag, given, best, length(motion), length(found), difference(found, motion))


def suspicion(fits: Sequence[Fit], lag: int) -> float:
    """Misfit in m from which on a better motion is looked for, after fits of the same recording."""
    innocent = [AGAIN * fit.given for fit in fits if fit.lag == lag and fit.best > BETTER * fit.given]
    return min(CERTAIN, max([SUSPECT[lag], *innocent]))


def check_fits(fits: Sequence[Fit]) -> Finding | None:
    """Bad if, at one lag, another motion fits far better than that of the poses; None if not, or if nothing shows."""
    for lag in sorted({fit.lag for fit in fits}):
        seen = [fit for fit in fits if fit.lag == lag and not math.isnan(fit.given)]
        wrong = [fit for fit in seen if fit.wrong]
        if len(wrong) >= WITNESSES and 2 * len(wrong) > len(seen):
            given, best, moves, should = (
                median(getattr(fit, name) for fit in wrong) for name in ("given", "best", "moves", "should")
            )
            text = (
                f"static surroundings {scans(lag)} later lie {metres(given)} off under these poses, which move the "
                f"sensor by {moves:.2f} m, and {metres(best)} under the motion that fits best, {should:.2f} m. Poses "
                "must be T_world_lidar in m: not of a camera, not inverted, not relative"
            )
            return Finding("bad", "alignment", text)
    return None


def length(motion: Motion) -> float:
    """Distance in m that the sensor moves."""
    return float(np.linalg.norm(motion[:3, 3]))


def difference(one: Motion, other: Motion) -> float:
    """About how far apart in m two motions take a point 10 m away, at most."""
    turned = np.clip((np.trace(one[:3, :3].T @ other[:3, :3]) - 1) / 2, -1, 1)
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3]) + FAR_POINT * math.acos(turned))


def scans(count: int) -> str:
    return f"{count} scan{'s' if count > 1 else ''}"


def metres(misfit: float) -> str:
    return f"{100 * misfit:.1f} cm" if misfit < REACH else f"over {REACH:g} m"


def _search(view: View, landmarks: Points, misfit: float, start: Motion) -> tuple[float, Motion]:
    """Step by step from a motion and its misfit to the lowest one."""
    place: tuple[float, ...] = (0.0, 0.0, 0.0)  # m forward, m left, m of turn at LEVER, from `start`
    found = start
    for stride in STRIDES:
        for _ in range(ROUNDS):
            before = misfit
            for axis in range(3):
                for step in (stride, -stride):
                    trial = (*place[:axis], place[axis] + step, *place[axis + 1 :])
                    motion = _moved(trial) @ start
                    value = view.misfit(landmarks, motion)
                    if value < misfit:
                        misfit, place, found = value, trial, motion
                        break
            if misfit == before:
                break
    return misfit, found


def _moved(place: tuple[float, ...]) -> Motion:
    motion = np.eye(4)
    cosine, sine = math.cos(place[2] / LEVER), math.sin(place[2] / LEVER)
    motion[0, :2], motion[1, :2] = (cosine, -sine), (sine, cosine)
    motion[:2, 3] = place[:2]
    return motion

"""How the frame of a scan lies in that of the sensor that measured it.

Seen from where they start, beams have the same elevation all around. In a frame that is tilted against the sensor's, or
begins elsewhere, as that of a vehicle may, elevations rise and fall with azimuth and with nearness: which tells how.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.sensors.beams import Beams, look

WEIGHINGS = 6  # of groups, by how well they fit
STEPS = 5  # towards the sensor's frame
TILT = 1.5  # degrees from which it is another frame than the scan's: 2 cost 7 points of IoU on a real drive
ASIDE, ABOVE = 1.0, 0.5  # m, likewise; scans of a car that drives fast show some of the former
LEFT, LITTLE = 0.5, 0.1  # of these, what may be left at the end, and what needs no further step
# m ahead and above the origin: where beams may start. From far away they are not told apart, and no step leads there
STARTS = (0.0, 0.0), (0.0, 0.7), (0.0, 1.7), (1.3, 1.7), (1.3, 0.7)
SURE, CERTAIN = 0.04, 0.01  # degrees, median misfit of groups at the end; less needs no other start

Pose = NDArray[np.float64]


def own_frame(
    points: NDArray[np.floating], ring: ArrayLike | None, seen: Beams, doubtful: bool = False
) -> tuple[Beams, Pose | None]:
    """The beams of a scan in the frame of its sensor, and (4, 4) T_sensor_scan; None where that is the scan's own.

    points: (N, >=3) m. It is found step by step, and given up where the steps lead nowhere. doubtful: even if it does
    not look as if it were another.
    """
    if seen.level is not None or (not doubtful and Fit(seen).another < 1):
        return seen, None
    xyz = points[:, :3].astype(np.float64)
    found: list[tuple[float, Beams, Pose]] = []
    for start in STARTS:
        if one := _steps(xyz, ring, start):
            found.append(one)
            if one[0] < CERTAIN or one[1].level is not None:
                break
    if not found:
        return seen, None
    _, own, pose = min(found, key=lambda one: one[0])
    pose[:2, 3] *= math.hypot(*pose[:2, 3]) >= ASIDE
    pose[2, 3] *= abs(pose[2, 3]) >= ABOVE
    same = not pose[:3, 3].any() and pose[2, 2] > math.cos(math.radians(TILT))
    return (seen, None) if same else (own, pose)


def _steps(
    xyz: NDArray[np.float64], ring: ArrayLike | None, start: tuple[float, float]
) -> tuple[float, Beams, Pose] | None:
    """From the frame that begins `start` m ahead and above: the misfit, and as `own_frame`; None where to nothing."""
    pose = np.eye(4)
    pose[[0, 2], 3] = -start[0], -start[1]
    own = _look_from(xyz, ring, pose)
    if own is None:
        return None
    fit = Fit(own)
    for _ in range(STEPS):
        pose = fit.moves() @ pose
        own = _look_from(xyz, ring, pose)
        if own is None:
            return None
        fit = Fit(own)
        if fit.another < LITTLE:
            break
    return (fit.misfit, own, pose) if fit.another < LEFT and fit.misfit < SURE else None


def _look_from(xyz: NDArray[np.float64], ring: ArrayLike | None, pose: Pose) -> Beams | None:
    with np.errstate(over="ignore", invalid="ignore"):
        return look(xyz @ pose[:3, :3].T + pose[:3, 3], ring)


class Fit:
    """The tilt of the beams of a scan, and where they start."""

    def __init__(self, beams: Beams) -> None:
        """Least squares over groups, each against the others of its beam; those that fit badly count little."""
        groups, beam = beams.groups, beams.beam
        azimuth, elevation = np.radians(groups.azimuth), np.radians(groups.elevation)
        cos, sin, near = np.cos(azimuth), np.sin(azimuth), np.degrees(groups.nearness)
        down = -near * np.sin(elevation)
        causes = np.stack([cos, sin, down * cos, down * sin, near * np.cos(elevation)], 1)  # (G, 5)
        weight = np.ones(len(beam))
        for _ in range(WEIGHINGS):
            total = np.bincount(beam, weight)
            means = np.stack([np.bincount(beam, weight * cause) / total for cause in causes.T], 1)
            own, mean = causes - means[beam], np.bincount(beam, weight * groups.elevation) / total
            rest = groups.elevation - mean[beam]
            share = np.sqrt(weight)
            solution = np.linalg.lstsq(own * share[:, None], rest * share, rcond=None)[0]
            misfit = np.abs(rest - own @ solution)
            middle = float(np.median(misfit)) + 1e-6
            weight = 1 / (1 + (misfit / (2 * middle)) ** 2) ** 2
        self.front, self.left = solution[:2].tolist()  # degrees that beams ahead, and to the left, look up
        self.start = solution[2:]  # m, of the beams in the scan's frame
        self.misfit = middle  # degrees

    @property
    def another(self) -> float:
        """How different the two frames are, where 1 makes a difference."""
        x, y, z = self.start.tolist()
        return float(max(math.hypot(self.front, self.left) / TILT, math.hypot(x, y) / ASIDE, abs(z) / ABOVE))

    def moves(self) -> Pose:
        """(4, 4) what takes points of the scan into the frame of the sensor."""
        pitch, roll = math.radians(self.front), -math.radians(self.left)
        about_y = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
        about_x = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
        pose = np.eye(4)
        pose[:3, :3] = about_x @ about_y
        pose[:3, 3] = -pose[:3, :3] @ self.start
        return pose

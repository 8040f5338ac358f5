"""Do poses fit their scans? Static surroundings of two scans must fall together once they are applied."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from runtime.recordings.poses import Poses
from runtime.recordings.scans import ScanData

CELL = 1.0  # m, side of the ground cells in which upright things are looked for
UPRIGHT = 0.8  # m, height that the points of a cell must span to be an upright thing
ABOVE = 0.3  # m over the lowest point of the cell: leaves out the ground, whose rings move along with the sensor
NEAR, FAR = 3.0, 40.0  # m, range of the points that are compared
QUERIES = 2000  # points of a scan that are compared
REACH = 1.0  # m, a point farther from everything counts as this far

Points = npt.NDArray[np.float64]  # (N, 3) m


def upright(scan: ScanData) -> Points:
    """Points on walls, trunks, cars and the like, (M, 3) float64: of cells that span a height."""
    points: Points = scan[:, :3].astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(points, axis=1)
        points = points[(distance > NEAR) & (distance < FAR)]
    if len(points) == 0:
        return points
    cells = np.floor(points[:, :2] / CELL).astype(np.int64)
    _, cell = np.unique(cells[:, 0] * 65536 + cells[:, 1], return_inverse=True)
    low = np.full(cell.max() + 1, np.inf)
    high = -low
    np.minimum.at(low, cell, points[:, 2])
    np.maximum.at(high, cell, points[:, 2])
    chosen: Points = points[((high - low)[cell] > UPRIGHT) & (points[:, 2] > low[cell] + ABOVE)]
    return chosen


@dataclass(frozen=True)
class Landmarks:
    """The upright things of one scan, ready to be compared."""

    points: Points
    tree: cKDTree

    @classmethod
    def of(cls, scan: ScanData) -> "Landmarks":
        points = upright(scan)
        return cls(points, cKDTree(points))

    def misfit(self, other: "Landmarks", relative: npt.NDArray[np.float64]) -> float:
        """Median distance in m, at most REACH, from `other`, moved by T_self_other, to the nearest here."""
        if len(self.points) == 0 or len(other.points) == 0:
            return REACH
        step = max(1, len(other.points) // QUERIES)
        moved = other.points[::step] @ relative[:3, :3].T + relative[:3, 3]
        distance, _ = self.tree.query(moved, distance_upper_bound=REACH)
        return float(np.minimum(np.median(distance), REACH))


Pair = tuple[int, int]  # an earlier and a later scan


def choose_pairs(count: int, margin: int, most: int = 10) -> list[Pair]:
    """Up to `most` pairs of scans, some steps apart and at least `margin` scans from both ends; may be []."""
    gap = min(5, max(1, count // 3))
    first, last = margin, count - margin - gap - 1
    if last < first:
        return []
    starts = np.unique(np.linspace(first, last, most).round().astype(int))
    return [(int(start), int(start) + gap) for start in starts]


def misfits(landmarks: dict[int, Landmarks], poses: Poses, pairs: list[Pair], shift: int = 0) -> list[float]:
    """Misfit of each pair of scans under poses T_world_lidar (T, 4, 4) of `shift` scans later."""
    return [landmarks[a].misfit(landmarks[b], np.linalg.inv(poses[a + shift]) @ poses[b + shift]) for a, b in pairs]

"""How often places were looked at: a ray ended there, or it went on to something behind.

What moves was not there before, or is not there later: then rays go through its place. So a place that every look found
occupied stands still, whatever labels say. The idea to clean maps by what rays went through is that of DUFOMap (Duberg
et al., RA-L 2024) and others; here it is only asked of what is called moving, by the directions of each scan.
"""

import math

import numpy as np
from numpy.typing import NDArray

from runtime.belief.free_space import ENDED, THROUGH, look
from runtime.cleaning.voxel_votes import MovingVoxels
from runtime.compute.arguments import need
from runtime.compute.jit import inlined, kernel
from runtime.recordings.poses import Pose

CELL = math.radians(0.4)  # of directions, in azimuth and elevation
WINDOW = 100  # scans before and after a place was seen last: beyond, poses may have drifted
COLUMN = 0.8  # m, side of columns of the world, whose places are judged together
FREE = 0.35  # share of the looks that go through a column in which something moves, at least: by `bench.cleaning_rules`
AREA = 0.1  # m^2, of the voxels that are free in a column and the 8 around it: less is no mover
_COLUMNS, _ROWS = round(2 * math.pi / CELL), round(math.pi / CELL)
_NEAREST = 0.5  # m, of returns
_NEXT = 1 << 32  # from a column to the next along x; to the next along y it is 1


class Looks:
    """The looks of scans at voxels that move. Not for concurrent calls."""

    def __init__(self, voxels: MovingVoxels) -> None:
        self.voxels = voxels
        self.through, self.ended = (np.zeros(len(voxels.rows), np.int32) for _ in range(2))  # (M,) looks
        self._scans = 0
        self._image = np.empty((_ROWS, _COLUMNS), np.float32)

    def add(self, points: NDArray[np.float32], place: Pose) -> None:
        """Those of the next scan: points (N, 3) m, as the LiDAR sees them; place: T_lidar_world. Raises ScanError."""
        need(points, "points", (None, 3), np.float32)
        need(place, "place", (4, 4), np.float64)
        self._scans += 1
        near = self._scans - WINDOW, self._scans + WINDOW + 1
        start, stop = np.searchsorted(self.voxels.last, near)
        if start < stop:
            _measure(points, self._image)
            counts = self.through[start:stop], self.ended[start:stop]
            _look(self.voxels.places[start:stop], place, self._image, *counts)

    def free(self, least: float = FREE, area: float = AREA) -> NDArray[np.bool_]:
        """(M,) whether rays went through a voxel, by at least this share of all looks through what moves in its column,
        and through as many voxels there and around as this area (m^2) of a surface has.

        The column tells what moves from what stands and was seen past at its edges; the voxel, from the ground below.
        """
        of_voxel = np.floor(self.voxels.places[:, :2] / COLUMN).astype(np.int64) @ np.array((_NEXT, 1))
        columns, column = np.unique(of_voxel, return_inverse=True)
        through, ended = (np.bincount(column, looks) for looks in (self.through, self.ended))
        enough = through >= least * (through + ended)
        free: NDArray[np.bool_] = (self.through > 0) & enough[column]
        size = np.bincount(column, free)
        around = np.zeros(len(columns))
        for step in (x * _NEXT + y for x in (-1, 0, 1) for y in (-1, 0, 1)):
            at = np.searchsorted(columns, columns + step) % max(1, len(columns))
            around += np.where(columns[at] == columns + step, size[at], 0)
        return free & (around >= round(area / self.voxels.size**2))[column]


@inlined
def _cell(x, y, z, r, rows, columns):  # type: ignore[no-untyped-def]
    """The row and the column of the direction of a place (x, y, z) m, r m away."""
    row = min(int((np.arcsin(z / r) + np.pi / 2) / CELL), rows - 1)
    column = int((np.arctan2(y, x) + np.pi) / CELL) % columns
    return row, column


@kernel
def _measure(points, image):  # type: ignore[no-untyped-def]
    """The range of the nearest return in each cell of directions; infinity where there is none."""
    rows, columns = image.shape
    image[:] = np.inf
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        r = np.sqrt(x * x + y * y + z * z)
        if r >= _NEAREST and r < np.inf:  # NaN is neither
            row, column = _cell(x, y, z, r, rows, columns)
            image[row, column] = min(image[row, column], r)


@kernel
def _look(places, to_lidar, image, through, ended):  # type: ignore[no-untyped-def]
    """Count what the cell of each place and those around it say: the nearest return there lies behind, or at it."""
    rows, columns = image.shape
    for i in range(places.shape[0]):
        x, y, z = to_lidar[:3, 3]
        for k in range(3):
            x += to_lidar[0, k] * places[i, k]
            y += to_lidar[1, k] * places[i, k]
            z += to_lidar[2, k] * places[i, k]
        r = np.sqrt(x * x + y * y + z * z)
        if r < _NEAREST:
            continue
        row, column = _cell(x, y, z, r, rows, columns)
        nearest = np.float32(np.inf)
        for a in range(max(row - 1, 0), min(row + 2, rows)):
            for b in range(column - 1, column + 2):
                nearest = min(nearest, image[a, b % columns])
        said = look(nearest, r)
        if said == THROUGH:
            through[i] += 1
        elif said == ENDED:
            ended[i] += 1

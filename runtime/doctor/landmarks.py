"""Walls, trunks, poles and cars of a scan, and how far they lie from what another scan shows."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from runtime.compute.jit import fast_kernel, kernel
from runtime.image.projection import pixel_scale
from runtime.sensors.range_image import RangeImage

LOOKED_AT = 16_384  # points of a scan in which upright things are looked for
MOST = 300  # points on them that are compared
NEAR, FAR = 3.0, 40.0  # m, range of the points that are compared
CELL = 1.0  # m, side of the ground cells in which upright things are looked for
UPRIGHT = 0.8  # m, height that the points of a cell must span to be an upright thing
ABOVE = 0.3  # m over the lowest point of the cell: leaves out the ground, whose rings move along with the sensor
APIECE = 20  # points of a cell at most, so that a near lorry counts no more than the houses around it
REACH = 1.0  # m, a point farther from everything counts as this far
FEWEST = 50  # points that must fall on something, else nothing can be said

Points = npt.NDArray[np.float32]  # (M, 3) m
Motion = npt.NDArray[np.float64]  # (4, 4) T_current_past


def upright_points(points: npt.NDArray[np.float32]) -> Points:
    """Some points on upright things, (M, 3) m, M <= MOST, of usable points of a scan (N, >=3) f32 m."""
    step = max(1, math.ceil(len(points) / LOOKED_AT))
    while step > 1 and not (step % 2 and step % 5):  # else it meets the same few of 64 or 40 beams
        step += 1
    found = np.empty((math.ceil(len(points) / step), 3), np.float32)
    count = _upright(points, step, found)
    return np.ascontiguousarray(found[: count : max(1, math.ceil(count / MOST))])


@dataclass(frozen=True)
class View:
    """What the sensor sees, as a range image."""

    nearest: npt.NDArray[np.float32]  # (H, W) m, 0 or infinity where the pixel is empty
    geometry: RangeImage

    def misfit(self, landmarks: Points, motion: Motion) -> float:
        """Mean distance in m along the ray, at most REACH, from landmarks of a past scan, moved by T_current_past, to
        the nearest surface in the pixels around; NaN where too few fall on pixels with something in them.

        Those far behind what is seen now are hidden and left out; those in front of it count.
        """
        bins, _, below, fov, rows = pixel_scale(self.geometry)
        lines = bins, np.float32(-below), np.float32(fov), rows
        total, count = _misfit(landmarks, np.ascontiguousarray(motion, np.float32), *lines, self.nearest)
        return float(total / count) if count >= FEWEST else math.nan


@kernel
def _upright(points, step, found):  # type: ignore[no-untyped-def]
    """Write points of cells that span a height to `found`; how many. Looks at every `step`-th point."""
    far, cell, upright, above = np.float32(FAR), np.float32(CELL), np.float32(UPRIGHT), np.float32(ABOVE)
    nearest, farthest = np.float32(NEAR * NEAR), np.float32(FAR * FAR)
    side = int(2 * FAR / CELL)
    low = np.full(side * side, np.float32(np.inf))
    high = np.full(side * side, np.float32(-np.inf))
    cells = np.full(found.shape[0], np.int32(-1))  # of every point that is looked at
    for k in range(found.shape[0]):
        x, y, z = points[k * step, 0], points[k * step, 1], points[k * step, 2]
        flat = x * x + y * y
        if nearest < flat < farthest:  # nor NaN
            at = int((x + far) / cell) * side + int((y + far) / cell)
            low[at], high[at], cells[k] = min(low[at], z), max(high[at], z), at
    taken = np.zeros(side * side, np.int32)
    count = 0
    for k in range(found.shape[0]):
        at = cells[k]
        if at >= 0 and high[at] - low[at] > upright and points[k * step, 2] > low[at] + above and taken[at] < APIECE:
            taken[at] += 1
            for axis in range(3):
                found[count, axis] = points[k * step, axis]
            count += 1
    return count


@fast_kernel
def _misfit(landmarks, motion, bins, down, fov, rows, nearest):  # type: ignore[no-untyped-def]
    """Sum of the distances and number of the landmarks that fall on something; float32, see `pixel_scale` for lines."""
    height, width = nearest.shape
    one, nothing, reach = np.float32(1), np.float32(0), np.float32(REACH)
    lines, columns = np.float32(bins), np.float32(width / (2 * math.pi))
    total, count = nothing, 0
    for i in range(landmarks.shape[0]):
        px, py, pz = landmarks[i, 0], landmarks[i, 1], landmarks[i, 2]
        x = motion[0, 0] * px + motion[0, 1] * py + motion[0, 2] * pz + motion[0, 3]
        y = motion[1, 0] * px + motion[1, 1] * py + motion[1, 2] * pz + motion[1, 3]
        z = motion[2, 0] * px + motion[2, 1] * py + motion[2, 2] * pz + motion[2, 3]
        flat = np.sqrt(x * x + y * y)
        distance = np.sqrt(flat * flat + z * z)
        row = int((one - (math.atan2(z, flat) - down) / fov) * lines)
        if rows.shape[0]:
            row = rows[min(max(row, 0), bins - 1)]
        if not 1 <= row < height - 1:  # in the edge rows lies what is out of the field of view
            continue
        column = int(width // 2 - math.atan2(y, x) * columns)
        off, hidden = reach, True
        for v in range(row - 1, row + 2):
            for u in range(column - 1, column + 2):
                seen = nearest[v, u + width if u < 0 else u - width if u >= width else u]
                if nothing < seen < np.float32(np.inf):
                    off = min(off, abs(seen - distance))
                    hidden = hidden and seen < distance - reach
        if not hidden:
            total += off
            count += 1
    return total, count

"""What other scans saw at the place of a point: a ray ended there, or went on to something behind.

What moves was not there some seconds ago, and will not be a second later: then rays go through its place. The
network compares a scan with the 8 before it, in which what is slow hardly leaves its place. The idea is that of
Dynablox (Schmid et al., RA-L 2023), DUFOMap (Duberg et al., RA-L 2024) and others; here it is only asked of points that
may move.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.manifest import BeliefNumbers
from runtime.bundle.residual import HISTORY
from runtime.compute.arena import aligned_empty
from runtime.compute.arguments import need
from runtime.compute.jit import fast_kernel, inlined
from runtime.compute.workers import Workers
from runtime.image.projection import BLOCK, pixel_scale, project_block
from runtime.recordings.poses import Pose, relative_pose
from runtime.sensors.range_image import RangeImage

STRIDE = 4  # scans between those that are looked at
LATER = 8  # scans after that of a point: the last that is looked at, where a delay allows
ASIDE, PER_METRE = np.float32(0.3), np.float32(0.01)  # m, and of the range: returns as near in range are from there
ACROSS = 2  # columns to each side of a place whose returns count; rows may be degrees apart, so only its own does
THROUGH, ENDED, UNSEEN = 0, 1, 2  # what a look at a place says
_GRAIN = 4 * BLOCK  # points per task


@dataclass(frozen=True)
class Sight:
    """A scan as it was seen."""

    points: NDArray[np.float32]  # (N, 4) x, y, z in m, the sensor's frame, and remission
    pose: Pose  # (4, 4) T_world_lidar
    number: int  # of the scan, counted by `FreeSpace`
    range_image: NDArray[np.float32]  # (H, W) m, range of the nearest point of each pixel, 0 where it is empty; a
    # buffer, until the scan is added

    def copy(self) -> "Sight":
        """In arrays of its own."""
        return Sight(self.points.copy(), self.pose.copy(), self.number, self.range_image)


class FreeSpace:
    """The range images of the last scans, and where they were seen from. Not for concurrent calls."""

    def __init__(self, numbers: BeliefNumbers, range_image: RangeImage, workers: Workers, later: int = 0) -> None:
        """later: scans that are added before those of a scan are asked for, at most."""
        self._workers = workers
        self._lags = (
            *range(-STRIDE, -min(later, LATER) - 1, -STRIDE),
            *range(HISTORY + 1, numbers.look_back + 1, STRIDE),
        )
        self._kept = numbers.look_back + later + 1 if self._lags else 0
        self._weights = np.array((numbers.through, numbers.ended, numbers.unseen), np.float32)
        self._added = 0
        self.lay_out(range_image)
        if self._kept:  # compile
            self._look(np.empty((0, 4), np.float32), np.empty(0, np.int64), np.eye(4), [], np.empty(0, np.float32))

    def lay_out(self, range_image: RangeImage) -> None:
        """For scans of a sensor; all images of before are forgotten."""
        self._shape, self._scale = (range_image.height, range_image.width), pixel_scale(range_image)
        self._images = aligned_empty((self._kept, *self._shape), np.float32)
        self._poses: dict[int, Pose] = {}  # of the scans that are kept, by their numbers

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return self._images.nbytes

    def clear(self) -> None:
        """Forget everything."""
        self._poses = {}

    def sight(self, points: NDArray[np.float32], pose: Pose, range_image: NDArray[np.float32]) -> Sight:
        """The next scan, before it is added."""
        return Sight(points, pose, self._added, range_image)

    def add(self, sight: Sight) -> None:
        """Keep the range image of the next scan."""
        if self._kept:
            self._images[sight.number % self._kept] = sight.range_image
            self._poses[sight.number] = sight.pose.copy()
            self._poses.pop(sight.number - self._kept, None)
        self._added = sight.number + 1

    def weigh(self, sight: Sight, log_odds: NDArray[np.float32], least: float) -> None:
        """Add what other scans say to the log-odds (N,) of the points that have at least `least`, in place.

        Raises ScanError.
        """
        need(sight.points, "points", (None, 4), np.float32)
        need(log_odds, "log_odds", sight.points.shape[:1], np.float32)
        numbers = [number for lag in self._lags if (number := sight.number - lag) in self._poses]
        if numbers:
            chosen = np.flatnonzero(log_odds >= least)
            self._workers.ranges(
                lambda start, stop: self._look(sight.points, chosen[start:stop], sight.pose, numbers, log_odds),
                len(chosen),
                _GRAIN,
            )

    def _look(
        self,
        points: NDArray[np.float32],
        chosen: NDArray[np.int64],
        pose: Pose,
        numbers: Sequence[int],
        log_odds: NDArray[np.float32],
    ) -> None:
        moves = np.empty((len(numbers), 3, 4), np.float32)  # T_other_lidar
        for move, number in zip(moves, numbers, strict=True):
            move[:] = relative_pose(self._poses[number], pose)[:3]
        slots = np.array([number % self._kept for number in numbers], np.int64)
        _look(points, chosen, moves, slots, self._images, self._scale, self._weights, log_odds)


@inlined
def look(nearest, distance):  # type: ignore[no-untyped-def]
    """What the nearest return (m, infinity: none) in the direction of a place says of it, `distance` m away."""
    near = ASIDE + PER_METRE * distance
    if nearest == np.float32(np.inf) or nearest < distance - near:
        return UNSEEN
    return THROUGH if nearest > distance + near else ENDED


@inlined
def _state(image, pixel, distance):  # type: ignore[no-untyped-def]
    """What a range image (H, W) says of a place: by the nearest return in its pixel and those beside it.

    At the edge of the view, where all that lies beyond it is projected to, it says nothing.
    """
    height, width = image.shape
    row = pixel // width
    if pixel < 0 or row == 0 or row == height - 1:
        return UNSEEN
    nearest = np.float32(np.inf)
    for u in range(pixel % width - ACROSS, pixel % width + ACROSS + 1):
        r = image[row, u % width]
        if r > 0:
            nearest = min(nearest, r)
    return look(nearest, distance)


@fast_kernel
def _look(points, chosen, moves, slots, images, scale, weights, log_odds):  # type: ignore[no-untyped-def]
    """Add the weights (3,) of what images[slots] say of the points `chosen`, each seen through its transform."""
    block, xyz = np.empty((BLOCK, 3), np.float32), np.empty((3, BLOCK), np.float32)
    pixel, distance = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.float32)
    for start in range(0, chosen.size, BLOCK):
        stop = min(start + BLOCK, chosen.size)
        count = stop - start
        for i in range(count):
            for axis in range(3):
                block[i, axis] = points[chosen[start + i], axis]
        for s in range(slots.size):
            project_block(block[:count], moves[s], scale, xyz, pixel, distance)
            for i in range(count):
                log_odds[chosen[start + i]] += weights[_state(images[slots[s]], pixel[i], distance[i])]

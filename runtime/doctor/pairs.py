"""Pairs of scans of a recording, some steps apart, whose surroundings are to be compared."""

import contextlib
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from runtime.doctor.alignment import LAGS
from runtime.doctor.check_sensor import count_beams
from runtime.doctor.landmarks import FEWEST, Motion, Points, View, upright_points
from runtime.doctor.sample import Sample, quantile
from runtime.errors import MosError
from runtime.image.projection import nearest_range, pixel_scale
from runtime.recordings.poses import Poses, relative_pose
from runtime.recordings.recording import Indexed
from runtime.sensors.range_image import RangeImage

PAIRS = 8  # of each lag, at most


@dataclass(frozen=True)
class Pair:
    """An earlier and a later scan."""

    earlier: int
    later: int
    landmarks: Points  # of the earlier
    view: View  # of the later

    @property
    def lag(self) -> int:
        return self.later - self.earlier

    def motion(self, poses: Poses, shift: int = 0) -> Motion:
        """T_later_earlier by the poses of `shift` scans later."""
        return relative_pose(poses[self.later + shift], poses[self.earlier + shift])


def read_pairs(recording: Indexed, geometry: RangeImage, margin: int) -> list[Pair]:
    """Pairs of each lag that the recording is long enough for, if possible at least `margin` scans from both ends.

    Scans that cannot be read or show too little are left out.
    """
    count = len(recording)
    lags = [lag for lag in LAGS if lag == LAGS[0] or lag <= count // 3]
    chosen = [(start, start + lag) for lag in lags for start in _starts(count, lag, margin)]
    landmarks: dict[int, Points] = {}
    views: dict[int, View] = {}
    for number in sorted({number for pair in chosen for number in pair}):
        with contextlib.suppress(MosError):  # check_files has said so
            points = _usable(recording.read(number).points)
            landmarks[number], views[number] = upright_points(points), view_of(points, geometry)
    return [
        Pair(earlier, later, landmarks[earlier], views[later])
        for earlier, later in chosen
        if later in views and len(landmarks.get(earlier, ())) >= FEWEST
    ]


def geometry_of(sample: Sample) -> RangeImage:
    """A range image that fits the sensor of a whole scan with usable points."""
    rows = min(128, max(16, 16 * round(count_beams(sample) / 16)))
    down, up = quantile(sample.elevations, 0.005), quantile(sample.elevations, 0.995)
    margin = max(0.1, (up - down) / rows)
    return RangeImage(rows, 2048 if rows >= 64 else 1024, min(90.0, up + margin), max(-90.0, down - margin))


def _starts(count: int, lag: int, margin: int) -> list[int]:
    if count < 2 * margin + lag + 1:
        margin = 0
    last = count - margin - lag - 1
    return [] if last < margin else [int(at) for at in np.unique(np.linspace(margin, last, PAIRS).round())]


def _usable(points: npt.NDArray[np.float32]) -> Points:
    """Those that are finite and not at the origin, (M, 3)."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (points * points).sum(1)
    return np.ascontiguousarray(points[np.isfinite(squares) & (squares > 0)])


def view_of(points: Points, geometry: RangeImage) -> View:
    """What is seen of usable points (N, 3) f32."""
    nearest = np.empty(geometry.height * geometry.width, np.float32)
    still = np.ascontiguousarray(np.eye(4, dtype=np.float32)[:3])
    nearest_range(points, still, pixel_scale(geometry), np.float32(0), np.float32(math.inf), nearest)
    return View(nearest.reshape(geometry.height, geometry.width), geometry)

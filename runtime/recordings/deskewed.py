"""A recording whose points were brought to the middle of their sweep, which is what the networks know."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from runtime.errors import MosError
from runtime.recordings.around import Around
from runtime.recordings.deskew import STILL, Motion, Velocity, deskewed, middle_of, span_of, velocity_between
from runtime.recordings.recording import Indexed, Scan
from runtime.recordings.remission import FIRST


def deskewing(recording: Indexed) -> Indexed:
    """The recording deskewed, if its first scan with points has times of them, and it has poses; else itself."""
    if recording.poses is None:
        return recording
    for index in range(min(FIRST, len(recording))):
        with suppress(MosError):  # is said when it is read
            scan = recording.read(index)
            if scan.times is not None:
                return Deskewed(recording, middle_of(scan.times), span_of(scan.times))
            if len(scan.data):
                break
    return recording


class Deskewed(Around):
    """Scans whose points, and pose, are those of the middle of the sweep; the others as they are.

    Between the poses of neighbouring scans the LiDAR is taken to move as `poses_at` has it. Where a neighbour is
    missing or too far away, it moves as on the other side; where both are, the scan stays as it is.
    """

    def __init__(self, within: Indexed, middle: float, span: float) -> None:
        """middle: s after the time of a scan; span: s of a sweep, between scans whose times are not known."""
        super().__init__(within)
        assert within.poses is not None
        self._raw, self._middle, self._span = within.poses, middle, span
        self.poses = np.stack([pose @ self.motion(index).at(middle) for index, pose in enumerate(self._raw)])

    def seen(self, index: int, scan: Scan) -> Scan:
        assert self.poses is not None
        pose = self.poses[index]
        if scan.times is None:
            return replace(scan, pose=pose)
        data = deskewed(scan.data, scan.times, self.motion(index), self._middle)
        return replace(scan, data=data, pose=pose, times=None)

    def motion(self, index: int) -> Motion:
        """Around scan number `index`."""
        before = None if index in self.lost else self._velocity(index, index - 1)
        after = None if index + 1 in self.lost else self._velocity(index, index + 1)
        known = before if after is None else after
        if known is None:
            return STILL
        return Motion(known if before is None else before, known if after is None else after)

    def _velocity(self, index: int, other: int) -> Velocity | None:
        """Between the poses of two neighbours; None where it is not known."""
        if not 0 <= other < len(self._raw) or not np.isfinite(self._raw[[index, other]]).all():
            return None
        seconds = (other - index) * self._span if self.times is None else float(self.times[other] - self.times[index])
        if not seconds * (other - index) > 0:
            return None
        return velocity_between(self._raw[index], self._raw[other], seconds)

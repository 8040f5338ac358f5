"""Where a scan comes in: it gets a pose, and points of one time."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.errors import PoseError, ScanError, SettingError
from runtime.odometry.odometry import Odometry, choose_odometry, located
from runtime.recordings.deskew import STILL, Motion, deskewed, middle_of, span_of, steady, velocity_between
from runtime.recordings.poses import Pose, check_pose
from runtime.recordings.recording import Scan
from runtime.recordings.scans import as_scan


@dataclass(frozen=True)
class Taken:
    """A scan that was taken in."""

    data: ArrayLike  # (N, 4) or (N, 3), yet to be checked
    pose: Pose  # (4, 4) float64 T_world_lidar, of the time that all points are of
    time: float | None  # s
    lost: str  # see `Scan.lost`
    stamped: Pose  # the pose at `time`


class Intake:
    """Takes scans in one after the other: finds the poses that are missing, and brings points with times together."""

    def __init__(self, odometry: str | Odometry | None, deskew: bool) -> None:
        """odometry: None: poses must be given. Raises SettingError, MissingPackageError."""
        self._chosen, self._deskew = odometry, deskew
        self.reset()

    def reset(self) -> None:
        """The next scan is the first of a sequence; to an odometry that was given as an object, it is the next one."""
        self._odometry = None if self._chosen is None else choose_odometry(self._chosen)
        self._before: Taken | None = None
        self._middle: float | None = None  # of the sweeps, s after the time of their scans

    def take(
        self, scan: ArrayLike | Scan, pose: ArrayLike | None, time: float | None, times: ArrayLike | None
    ) -> Taken:
        """A scan as `MosRunner` is given it.

        Raises ScanError, PoseError, SettingError (of the time), and what the odometry raises.
        """
        _check_time(time)
        given = scan if isinstance(scan, Scan) else None
        data: ArrayLike = scan if given is None else given.data  # type: ignore[assignment]
        pose = given.pose if given and pose is None else pose
        time = given.time if given and time is None else time
        point_times = _check_times(given.times if given and times is None else times, data) if self._deskew else None
        lost = given.lost if given else ""
        if pose is not None:
            stamped = check_pose(pose, "pose")
        elif self._odometry is not None:
            stamped, lost = located(self._odometry, as_scan(data), time, point_times)
        else:
            raise PoseError("a scan has no pose: give it, or let it be found (`odometry='kiss'`)")
        if point_times is None:
            return Taken(data, stamped, time, lost, stamped)
        motion = STILL if lost else self._motion(stamped, time, span_of(point_times))
        middle = middle_of(point_times) if self._middle is None else self._middle
        moved = deskewed(as_scan(data), point_times, motion, middle)
        self._middle = middle
        return Taken(moved, stamped @ motion.at(middle), time, lost, stamped)

    def keep(self, taken: Taken) -> None:
        """It has become the scan before."""
        self._before = taken

    def _motion(self, pose: Pose, time: float | None, span: float) -> Motion:
        """Since the scan before, and it goes on so."""
        if self._before is None:
            return STILL
        known = time is not None and self._before.time is not None
        seconds = time - self._before.time if known else span  # type: ignore[operator]
        return steady(velocity_between(pose, self._before.stamped, -seconds) if seconds > 0 else None)


def _check_times(times: ArrayLike | None, data: ArrayLike) -> NDArray[np.float32] | None:
    """Raises ScanError unless there is a time for each point."""
    if times is None:
        return None
    values = np.asarray(times, np.float32)
    if values.shape != (len(np.asarray(data)),):
        raise ScanError(f"times must be one for each of the points, not of shape {values.shape}")
    return values


def _check_time(time: float | None) -> None:
    """Raise SettingError unless `time` is a number of seconds or None."""
    try:
        known = time is None or math.isfinite(time)
    except (TypeError, OverflowError):
        known = False
    if not known:
        raise SettingError(f"time must be a number of seconds, or None, not {time!r}")

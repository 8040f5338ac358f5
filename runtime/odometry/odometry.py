"""What finds the pose of a scan from its points."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from runtime.errors import LostError, SettingError
from runtime.recordings.poses import Pose, check_pose
from runtime.recordings.scans import ScanData

KISS = "kiss"  # the name of KISS-ICP


@runtime_checkable
class Odometry(Protocol):
    """Finds poses, scan after scan. `KissOdometry` is one; yours may use an IMU, wheels or a map."""

    def locate(self, data: ScanData, time: float | None, times: NDArray[np.float32] | None) -> NDArray[np.float64]:
        """T_world_lidar (4, 4) of the next scan, at `time`; in whichever world, the same for all scans.

        data: (N, 4) or (N, 3) f32 x y z m, LiDAR frame, some of it not finite, and remission; not to be written to.
        time: s, of the scan; None where it is not known.
        times: (N,) s after `time` at which each point was measured; None: all at once.

        Raises LostError where it is not known how the scan lies to those before it. It is then asked for the same scan
        again, and begins anew.
        """
        ...


def choose_odometry(given: "str | Odometry") -> Odometry:
    """An odometry by its name, new; one that is given, as it is. Raises SettingError, MissingPackageError."""
    if given == KISS:
        from runtime.odometry.kiss import KissOdometry

        return KissOdometry()
    if not isinstance(given, Odometry):
        raise SettingError(f"`odometry` must be {KISS!r} or have a method 'locate', not {given!r}")
    return given


def name_of(odometry: Odometry) -> str:
    """What it calls itself (`name`), or its type."""
    return str(getattr(odometry, "name", type(odometry).__name__))


def located(
    odometry: Odometry, data: ScanData, time: float | None, times: NDArray[np.float32] | None
) -> tuple[Pose, str]:
    """The pose of a scan, and why it is not known how it lies to those before it ("" if it is). Raises PoseError."""
    arguments: tuple[Any, ...] = data, time, times
    lost = ""
    try:
        pose = odometry.locate(*arguments)
    except LostError as error:
        lost = str(error)
        pose = odometry.locate(*arguments)
    return check_pose(pose, "pose of the odometry"), lost

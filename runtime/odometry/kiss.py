"""KISS-ICP: point-to-point ICP against a local map, from a prediction at constant velocity.

Vizzo et al., *KISS-ICP: In Defense of Point-to-Point ICP*, IEEE Robotics and Automation Letters 8(2), 2023.
"""

import warnings
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree  # noqa: TID251 (comes with the extra)

from runtime.compute.packages import KISS_ICP, need_package
from runtime.errors import LostError, MosWarning
from runtime.recordings.deskew import STILL, Motion, deskewed, middle_of, span_of, steady, velocity_to
from runtime.recordings.poses import Pose, relative_pose
from runtime.recordings.scans import ScanData

FEWEST = 100  # points without which a scan has no place
# Share of a scan's points that lie within half a voxel of the scan before: 0.7 to 0.95 where the pose is right, gaps of
# 8 scans included, and 0.14 to 0.32 where it is not, or nothing is in common.
IN_COMMON = 0.5
LONGEST_STEP = 1.0  # s over which a velocity is believed


class KissOdometry:
    """Poses by KISS-ICP (package `kiss-icp`), in the frame of the first scan. The same scans give the same bits."""

    def __init__(self, max_range: float = 100.0, voxel_size: float = 1.0) -> None:
        """max_range: m, points farther away are left out; voxel_size: m, of the map; 0.2 suits rooms.

        Raises MissingPackageError.
        """
        need_package(KISS_ICP, "odometry")
        self.name = f"KISS-ICP {version('kiss-icp')}, points to {max_range:g} m, voxels of {voxel_size:g} m"
        self._max_range, self._voxel_size = max_range, voxel_size
        self._pose: Pose  # of the middle of the sweep before: there, what is wrong about the velocity cancels out
        self._motion: Motion  # since the one before that
        self._time: float | None
        self._begin(np.eye(4))

    def locate(self, data: ScanData, time: float | None = None, times: NDArray[np.float32] | None = None) -> Pose:
        """See `Odometry.locate`. A scan of few points is where constant velocity takes it, with a MosWarning."""
        seconds = self._since(time, times)
        motion = self._motion if seconds else STILL
        middle = 0.0 if times is None else middle_of(times)
        points = self._usable(data if times is None else deskewed(data, times, motion, middle))
        before, pose = self._pose, self._pose @ motion.at(seconds)
        if len(points) >= FEWEST:
            pose = self._register(points, pose)
            self._motion = motion = steady(velocity_to(before, pose, seconds)) if seconds else STILL
        else:
            warnings.warn(
                f"a scan has {len(points)} points within {self._max_range:g} m: its pose is that of constant velocity",
                MosWarning,
                stacklevel=2,
            )
        self._pose, self._time = pose, time
        return pose @ motion.back_from(middle)

    def _begin(self, pose: Pose) -> None:
        """The next scan is the first of a map, at T_world_lidar `pose`."""
        self._icp, self._pose, self._motion = _new_icp(self._max_range, self._voxel_size), pose, STILL
        self._time = None
        self._before: tuple[cKDTree, Pose] | None = None  # the points of the scan before, thinned out, and its pose

    def _since(self, time: float | None, times: NDArray[np.float32] | None) -> float:
        """s since the scan before, or scans where no time is known; 0 where no motion is known."""
        if self._before is None:
            return 0.0
        if time is None or self._time is None:
            return 1.0 if times is None else span_of(times)
        return time - self._time if 0 < time - self._time <= LONGEST_STEP else 0.0

    def _usable(self, data: ScanData) -> NDArray[np.float64]:
        """(M, 3) m, points within the range."""
        points = data[:, :3].astype(np.float64)
        squares = (points * points).sum(1)
        inside: NDArray[np.float64] = points[(squares > 0) & (squares <= self._max_range**2)]  # neither holds for NaN
        return inside

    def _register(self, points: NDArray[np.float64], guess: Pose) -> Pose:
        """The pose of a scan (M, 3), which joins the map. Raises LostError, and then begins anew at the guess."""
        self._icp.last_pose, self._icp.last_delta = guess, np.eye(4)
        _, thinned = self._icp.register_frame(points, np.empty(0))
        pose: Pose = np.array(self._icp.last_pose, dtype=np.float64)
        if self._before is not None:
            tree, place = self._before
            relative = relative_pose(place, pose)
            apart, _ = tree.query(thinned @ relative[:3, :3].T + relative[:3, 3], distance_upper_bound=self._voxel_size)
            share = float(np.mean(apart <= self._voxel_size / 2))
            if not share >= IN_COMMON:
                self._begin(guess)
                raise LostError(f"it has {share:.0%} in common with the scan before")
        self._before = cKDTree(self._icp.joined), pose
        return pose


def _new_icp(max_range: float, voxel_size: float) -> Any:
    """KISS-ICP as its package has it, but for deskewing, and on one thread: sums of several have no order."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.config.parser import AdaptiveThresholdConfig, DataConfig, MappingConfig, RegistrationConfig
    from kiss_icp.kiss_icp import KissICP

    class Icp(KissICP):  # type: ignore[misc]
        joined: NDArray[np.float64]  # (M, 3) m, what of the last scan has joined the map

        def voxelize(self, points: NDArray[np.float64]) -> Any:
            source, self.joined = super().voxelize(points)
            return source, self.joined

    return Icp(
        KISSConfig(  # all of it: what is not named here would be taken from environment variables
            data=DataConfig(max_range=max_range, min_range=0.0, deskew=False),
            registration=RegistrationConfig(max_num_threads=1),
            mapping=MappingConfig(voxel_size=voxel_size),
            adaptive_threshold=AdaptiveThresholdConfig(),
        )
    )

"""What moves in a recording: the votes of all scans, by what their labels say, and what rays went through."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.classes import MOVING, to_classes
from runtime.cleaning.looks import Looks
from runtime.cleaning.voxel_votes import VoxelVotes
from runtime.odometry.located import Progress, readable
from runtime.recordings.labels import read_prediction
from runtime.recordings.poses import Pose, relative_pose
from runtime.recordings.recording import Indexed, Scan
from runtime.recordings.scans import moved

VOXEL = 0.1  # m


class Stretch:
    """Scans of which it is known how they lie to each other, in the frame of the first."""

    def __init__(self, voxel: float) -> None:
        self.votes = VoxelVotes(voxel)
        self.keys: list[str] = []
        self._first: Pose | None = None
        self._looks: Looks | None = None

    def add(self, scan: Scan, moving: NDArray[np.bool_]) -> None:
        """A scan, and which of its points (N,) its labels call moving."""
        remission = np.zeros(len(scan.data), np.float32) if scan.remission is None else scan.remission
        self.votes.add(self._placed(scan), remission, moving)
        self.keys.append(scan.key)

    def moves(self, scan: Scan) -> NDArray[np.bool_]:
        """(N,) which points of a scan are in voxels that move."""
        return self.votes.moves(self._placed(scan))

    def look(self, scan: Scan, mounting: Pose) -> None:
        """All scans again, in their order: what their rays met where something moves. mounting: T_lidar_scan."""
        assert self._first is not None
        self._looks = self._looks or Looks(self.votes.moving())
        with np.errstate(invalid="ignore"):  # of points that are not finite
            points = moved(scan.points, mounting)
        self._looks.add(points, mounting @ relative_pose(scan.known_pose(), self._first))

    def settle(self) -> None:
        """What no ray went through stands still."""
        if self._looks is not None:
            self.votes.take_back(self._looks.voxels.rows[~self._looks.free()])
            self._looks = None

    def _placed(self, scan: Scan) -> NDArray[np.float64]:
        """(N, 3) m, in the frame of the first scan."""
        pose = scan.known_pose()
        self._first = pose if self._first is None else self._first
        place = relative_pose(self._first, pose)
        with np.errstate(invalid="ignore"):  # of points that are not finite
            placed: NDArray[np.float64] = scan.points.astype(np.float64) @ place[:3, :3].T + place[:3, 3]
        return placed


class RecordingVotes:
    """Of a whole recording, stretch by stretch: a new one begins where an odometry was lost."""

    def __init__(
        self,
        recording: Indexed,
        labels: Path,
        voxel: float = VOXEL,
        on_progress: Progress = lambda done, total: None,
        mounting: Pose | None = None,
    ) -> None:
        """Reads the recording twice, but for scans that cannot be read.

        labels: folder of a label file for each scan, as `predict` writes them. voxel: m. mounting: T_lidar_scan, where
        the points are not in the frame of the LiDAR. Raises SequenceError where a label file is missing or of another
        scan, SettingError.
        """
        self.recording = recording
        self.stretches = [Stretch(voxel)]
        self._of: dict[int, Stretch] = {}
        numbers = range(len(recording))
        for index, scan in readable(recording, numbers, lambda done, total: on_progress(done // 2, total)):
            if scan.lost and self.stretches[-1].keys:
                self.stretches.append(Stretch(voxel))
            moving = to_classes(read_prediction(labels / f"{scan.key}.label", len(scan.data))) == MOVING
            self.stretches[-1].add(scan, moving)
            self._of[index] = self.stretches[-1]
        lidar = np.eye(4) if mounting is None else mounting
        for index, scan in readable(recording, numbers, lambda done, total: on_progress((total + done) // 2, total)):
            self._of[index].look(scan, lidar)
        for stretch in self.stretches:
            stretch.settle()

    def scans(self, on_progress: Progress = lambda done, total: None) -> Iterator[tuple[int, Scan, NDArray[np.bool_]]]:
        """Reads the recording again: the number of each scan, the scan, and which of its points (N,) stay."""
        for index, scan in readable(self.recording, range(len(self.recording)), on_progress):
            yield index, scan, ~self._of[index].moves(scan)

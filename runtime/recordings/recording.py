"""What was logged, whatever its format: a `Recording` gives one `Scan` after the other."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from runtime.errors import PoseError, SettingError
from runtime.recordings.fingerprint import fingerprint_of
from runtime.recordings.poses import Pose, Poses

FRAMES = ("camera", "lidar")
GIVEN_POSES = ("needed", "optional", "ignored")


@dataclass(frozen=True, eq=False)
class Scan:
    """One turn of the LiDAR. Nobody writes into its arrays."""

    key: str  # its name within the recording, and that of its label file
    data: npt.NDArray[np.float32]  # (N, 4) x, y, z in m, LiDAR frame, and remission 0..1; (N, 3) where there is none
    pose: Pose | None = None  # (4, 4) float64 T_world_lidar
    time: float | None = None  # s
    ring: npt.NDArray[np.integer] | None = None  # (N,) number of the laser
    times: npt.NDArray[np.float32] | None = None  # (N,) s after `time`, or after the first point; see `PointTimes`
    lost: str = ""  # why it is not known how this scan lies to those before it; "": it is

    @property
    def points(self) -> npt.NDArray[np.float32]:
        """(N, 3) m, a view."""
        return self.data[:, :3]

    @property
    def remission(self) -> npt.NDArray[np.float32] | None:
        """(N,), a view; None where the sensor or the format has none."""
        return self.data[:, 3] if self.data.shape[1] == 4 else None

    def known_pose(self) -> Pose:
        """The pose. Raises PoseError where there is none."""
        if self.pose is None:
            raise PoseError(f"scan {self.key} has no pose")
        return self.pose


@dataclass(frozen=True)
class Options:
    """How a recording is to be opened."""

    poses: Path | None = None  # pose file; None: where the format keeps it
    calib: Path | None = None  # calibration of a camera whose poses these are; None: where the format keeps it
    frame: str | None = None  # of FRAMES: whose poses the file holds; None: as the format has it
    limit: int | None = None  # only the first scans
    given_poses: str = "needed"  # of GIVEN_POSES: to have none is an error, or is not, or they are left out
    points_only: bool = False  # leave out poses and times, whatever state they are in
    topic: str | None = None  # of the clouds in a bag; None: the only one
    pose_topic: str | None = None  # of the poses in a bag; None: the only odometry in the frame of the points
    world: str | None = None  # frame of TF in which poses are; None: odom, or else the highest
    # where the LiDAR sits in the frame whose poses these are, see `read_extrinsics`; None: as the format has it
    extrinsics: str | Path | None = None
    columns: int | None = None  # numbers a point in files of raw numbers; None: as they show
    remission_scale: float | None = None  # what full remission is in the files; None: as the first scans show
    deskew: bool = True  # points with times are brought to the middle of their sweep, where poses are known
    skip_broken: bool = False  # a broken pose is an error of its scan, not of the recording

    def __post_init__(self) -> None:
        if self.frame not in (None, *FRAMES):
            raise SettingError(f"`frame` must be camera or lidar, not {self.frame!r}")
        if self.given_poses not in GIVEN_POSES:
            raise SettingError(f"given_poses must be one of {', '.join(GIVEN_POSES)}, not {self.given_poses!r}")
        if self.frame == "lidar" and self.calib:
            raise SettingError(f"poses of the LiDAR need no calibration: leave out `calib` ({self.calib}), or `frame`")
        if self.extrinsics and (self.calib or self.frame == "camera"):
            raise SettingError("poses are of a camera or of what `extrinsics` is given for: leave out one of the two")
        if self.poses and self.pose_topic:
            raise SettingError("poses are from a file (`poses`) or a topic (`pose_topic`): leave out one of the two")
        if self.world and self.poses:
            raise SettingError(
                "`world` is a frame of TF, and poses are from a file (`poses`): leave out one of the two"
            )
        if self.limit is not None and self.limit < 1:
            raise SettingError(f"`limit` must be at least 1, not {self.limit}")
        if self.columns is not None and self.columns < 3:
            raise SettingError(f"`columns` must be at least 3, for x y z, not {self.columns}")
        if self.remission_scale is not None and not 0 < self.remission_scale < float("inf"):
            raise SettingError(f"`remission_scale` must be above 0, not {self.remission_scale}")

    @property
    def reads_poses(self) -> bool:
        return not self.points_only and self.given_poses != "ignored"


DEFAULTS = Options()


@runtime_checkable
class Recording(Protocol):
    """Scans in order of time."""

    name: str  # from the path as it was given, never from where a link points
    source: str  # path or address, for messages
    sensor: str | None  # name of a sensor's profile, where the format knows it
    poses_from: str | None  # what the poses are read from; None: there are none

    def scans(self, start: int = 0) -> Iterator[Scan]:
        """The scans from number `start` on. Raises ScanError or PoseError at one that is broken."""
        ...

    def __iter__(self) -> Iterator[Scan]:
        return self.scans()

    def fingerprint(self, scan: Scan) -> str:
        """Of all that a label may depend on: points, remission, pose, time, times of points. Kept with the label."""
        return fingerprint_of(scan.data, scan.pose, scan.time, scan.times) + ("-" if scan.lost else "")


@runtime_checkable
class Indexed(Recording, Protocol):
    """A recording whose scans are at hand in any order. A reader gives `keys` and `read`; the rest has defaults."""

    keys: tuple[str, ...]  # of all scans, in order of time
    poses: Poses | None = None  # (T, 4, 4) float64 T_world_lidar
    times: npt.NDArray[np.float64] | None = None  # (T,) s
    lost: Mapping[int, str] = MappingProxyType({})  # see `Scan.lost`, by number

    def read(self, index: int) -> Scan:
        """Scan number `index`, from 0. Raises ScanError or PoseError."""
        ...

    def __len__(self) -> int:
        return len(self.keys)

    def scans(self, start: int = 0) -> Iterator[Scan]:
        return (self.read(index) for index in range(start, len(self)))

    def count(self, index: int) -> int:
        """Points of scan `index`. Raises ScanError."""
        return len(self.read(index).data)

    def remission_scale(self) -> float | None:
        """By what the remission in the files is divided; None: that is not known."""
        return None

    def labels(self, index: int) -> npt.NDArray[np.uint32] | None:
        """True labels of the points of scan `index` (N,), SemanticKITTI's numbers; None where there are none."""
        return None

    def write_kept(self, folder: Path, kept: Iterator[tuple[int, npt.NDArray[np.bool_]]]) -> None:
        """Write the recording into a new folder, in its own format, without some of its points, and all else as it is.

        kept: the numbers of scans, in order, and which of their points (N,) stay; scans that are not there are broken.
        Raises SettingError where the format cannot be written, and OutputError.
        """
        raise SettingError(f"{self.source}: its format cannot be written; choose another (`format='ply'`)")

    def check_takes_labels(self) -> None:
        """Raises SettingError unless `write_labelled` can write it."""
        raise SettingError(f"{self.source}: is no bag; labels go into clouds of their own (`write='cloud'`)")

    def write_labelled(
        self, folder: Path, labelled: Iterator[tuple[int, npt.NDArray[np.bool_], npt.NDArray[np.float32]]]
    ) -> None:
        """Write the recording into a new folder, in its own format, its points with labels, and all else as it is.

        labelled: the numbers of scans, in order, which of their points (N,) move, and with which probability (N,);
        scans that are not there have none. Raises as `check_takes_labels`, and OutputError.
        """
        self.check_takes_labels()

    def other_poses(self) -> dict[str, Poses]:
        """What the poses would be (T, 4, 4) if meant otherwise: "inverse", or of "camera" or "lidar" instead."""
        return {} if self.poses is None else {"inverse": np.linalg.inv(self.poses).astype(np.float64)}

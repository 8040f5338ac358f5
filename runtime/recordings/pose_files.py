"""Pose, calibration and time files beside scans: where they are, and which line belongs to which scan."""

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import MosError, MosWarning, NoPosesError, PoseError, SequenceError, some
from runtime.recordings.calib import read_calib
from runtime.recordings.extrinsics import mounted, read_extrinsics
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.poses import Pose, Poses, are_good, camera_to_lidar, check_pose, with_nearest_rotations
from runtime.recordings.recording import Options
from runtime.recordings.text import lines_of, read_text, to_numbers
from runtime.recordings.trajectory import poses_at

KITTI_AXES = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # T_camera_lidar, roughly
Times = npt.NDArray[np.float64]  # (T,) s
LONGEST_STEP = 1.0  # s between two scans, at the median: longer ones are no times in seconds


@dataclass(frozen=True)
class PoseFiles:
    """Where the poses of a recording come from."""

    poses: Path
    calib: Path | None  # None: the poses are no camera's
    extrinsics: str | Path | None = None  # where the LiDAR sits in the frame of the poses; None: they are its own

    @property
    def frame(self) -> str:
        return "lidar" if self.calib is None else "camera"

    def lidar_poses(self, raw: Poses) -> Poses:
        """T_world_lidar (T, 4, 4) of the poses as they stand in the file. Raises PoseError, SettingError."""
        if self.extrinsics is not None:
            return raw @ read_extrinsics(self.extrinsics)
        return raw if self.calib is None else camera_to_lidar(raw, read_calib(self.calib))

    def origin(self, folder: Path) -> str:
        """Words that change when other files are named, and not when all of it is moved."""
        files = [self.poses] if self.calib is None else [self.poses, self.calib]
        frame = self.frame if self.extrinsics is None else mounted(self.extrinsics)
        return f"{' and '.join(_from(folder, file) for file in files)}, {frame}"

    def readings(self, raw: Poses, folder: Path) -> dict[str, Poses]:
        """See `Indexed.other_poses`."""
        inverted: Poses = np.linalg.inv(raw).astype(np.float64)
        if self.calib is not None:
            return {"lidar": raw, "inverse": self.lidar_poses(inverted)}
        if self.extrinsics is not None:
            return {"inverse": self.lidar_poses(inverted)}
        try:
            tr: Pose = read_calib(folder / "calib.txt")
        except PoseError:
            tr = KITTI_AXES
        return {"camera": camera_to_lidar(raw, tr), "inverse": inverted}


def find_pose_files(folder: Path, options: Options) -> PoseFiles:
    """Pose and calibration file of a folder, each as given or else where KITTI keeps it, beside the path as given.

    Raises PoseError saying where a file was looked for, NoPosesError where that is not of a file that was named.
    """
    usual = [folder / "poses.txt", folder.parent.parent / "poses" / f"{folder.name}.txt"]
    pose_file = _first_file([options.poses] if options.poses else usual)
    if pose_file is None:
        if options.poses:
            raise PoseError(f"no poses: {options.poses} does not exist; name the file (`poses`)")
        looked = f"{usual[0]} or {usual[1]}"
        raise NoPosesError(
            f"no poses: {looked} does not exist; name the file (`poses`), or find them (`odometry='kiss'`)"
        )
    if options.frame == "lidar" or options.extrinsics is not None:
        return PoseFiles(pose_file, None, options.extrinsics)
    calib_file = _first_file([options.calib or folder / "calib.txt"])
    if calib_file is None:
        raise PoseError(
            f"no calibration: {options.calib or folder / 'calib.txt'} does not exist. KITTI poses are the camera's and "
            f"need the line 'Tr:' of its calib.txt (`calib`); if yours are the LiDAR's own, say so (`frame='lidar'`)"
        )
    return PoseFiles(pose_file, calib_file)


@dataclass(frozen=True)
class ScanPoses:
    """The poses of a recording's scans."""

    poses: Poses  # (T, 4, 4) float64 T_world_lidar
    broken: dict[int, str]  # what is wrong with the pose of a scan, by number
    origin: str  # see `Recording.poses_from`
    others: Callable[[], dict[str, Poses]]  # see `Indexed.other_poses`; no lambda, which no other process could get


def read_file_poses(folder: Path, scans: tuple[Path, ...], options: Options, times: Times | None) -> ScanPoses:
    """The poses of the first `options.limit` scans. Raises PoseError, SequenceError; warns as `match_lines` says.

    Where both scans and poses have times that overlap, each scan has the pose of its time (`poses_at`). Else
    line n of the pose file belongs to the n-th scan. Where it has more lines than there are scans, as with an
    excerpt of a long sequence, line n belongs to the scan numbered n, from 0, and a MosWarning says so.
    """
    files = find_pose_files(folder, options)
    table = read_pose_table(files.poses)
    raw = with_nearest_rotations(table.poses)
    if times is not None and table.times is not None and _overlap(times, table.times):
        raw, broken = poses_at(times, table.times, raw, str(files.poses))
        poses, names = files.lidar_poses(raw), [f"scan {scan.name}" for scan in scans]
    else:
        lines, broken = match_lines(scans, len(raw), f"{files.poses}: {len(raw)} poses", options.limit), {}
        if lines != list(range(len(lines))):
            warnings.warn(
                f"{files.poses}: {len(raw)} poses for {len(scans)} scans: each scan takes the line of its number "
                f"({lines[0]} to {lines[-1]}, from 0)",
                MosWarning,
                stacklevel=2,
            )
        poses, raw = files.lidar_poses(raw)[lines], raw[lines]
        names = [f"pose {line} (from 0, scan {scans[index].name})" for index, line in enumerate(lines)]
    names = [f"{files.poses}: {name}" for name in names]
    poses, broken = checked(poses, broken, names, options.skip_broken)
    return ScanPoses(poses, broken, files.origin(folder), partial(files.readings, raw, folder))


def checked(poses: Poses, broken: dict[int, str], names: list[str], skip_broken: bool) -> tuple[Poses, dict[int, str]]:
    """Poses (T, 4, 4) as `check_pose` has them, and what is wrong with the others, by number.

    broken: the same, known before; names: for messages. Raises PoseError unless skip_broken.
    """
    poses, broken = poses.copy(), dict(broken)
    for index in map(int, np.flatnonzero(~are_good(poses))):
        if index not in broken:
            try:
                poses[index] = check_pose(poses[index], names[index])
            except PoseError as error:
                broken[index] = str(error)
    if broken and not skip_broken:
        raise PoseError(
            f"{some(list(broken.values()), most=1)}. Such scans can be left without a label (`skip_broken`)"
        )
    return poses, broken


def _overlap(times: Times, known: Times) -> bool:
    """Whether two clocks are the same, as far as can be told."""
    return bool((times <= known.max()).any() and (times >= known.min()).any())


def match_lines(scans: tuple[Path, ...], count: int, what: str, limit: int | None = None) -> list[int]:
    """Which of `count` lines belongs to each of the first `limit` scans, from 0.

    Raises SequenceError, beginning with `what`, where they do not fit.
    """
    used = len(scans) if limit is None else min(limit, len(scans))
    if count == len(scans) or used <= count < len(scans):
        return list(range(used))
    if count < used:
        raise SequenceError(
            f"{what} for {used} scans in {scans[0].parent}; "
            f"name the whole file, or take the first scans (`limit={count}`)"
        )
    numbers = [int(scan.stem) for scan in scans if scan.stem.isdigit()]
    if len(numbers) < len(scans) or numbers[-1] >= count:
        raise SequenceError(
            f"{what} for {len(scans)} scans in {scans[0].parent}, whose names do not tell which is whose; "
            f"there must be one line for each scan"
        )
    return numbers[:used]


def read_times(file: Path, scans: tuple[Path, ...], limit: int | None) -> Times | None:
    """Times of the first `limit` scans in s; None where there is no file, or one of no use: then with a MosWarning."""
    if not file.is_file():
        return None
    try:
        values = np.array([value for _, fields in lines_of(read_text(file)) for value in to_numbers(fields)])
        if not np.isfinite(values).all():
            raise ValueError
        times: Times = values[match_lines(scans, len(values), f"{file}: {len(values)} times", limit)]
    except ValueError as error:  # as all of ours are too
        reason = str(error) if isinstance(error, MosError) else f"{file}: is not made of numbers"
    else:
        step = np.median(np.diff(values)) if len(values) > 1 else LONGEST_STEP
        if 0 < step <= LONGEST_STEP:
            return times
        reason = f"{file}: from scan to scan the time steps by {step:.3g}, so that these are no seconds"
    warnings.warn(f"{reason}; no times are used, gaps in them are not noticed", MosWarning, stacklevel=2)
    return None


def _from(folder: Path, file: Path) -> str:
    try:
        return os.path.relpath(file, folder)
    except ValueError:  # on another drive of Windows
        return os.path.abspath(file)


def _first_file(files: list[Path]) -> Path | None:
    return next((file for file in files if file.is_file()), None)

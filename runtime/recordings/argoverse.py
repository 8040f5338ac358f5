"""A drive of Argoverse 2: sweeps as Feather files named by their time in ns, and the poses of the vehicle."""

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import PoseError, ScanError, SequenceError, SettingError
from runtime.recordings.formats.feather import read_columns
from runtime.recordings.pose_files import ScanPoses, Times, checked, read_file_poses
from runtime.recordings.pose_table import from_quaternions
from runtime.recordings.poses import Pose, Poses, check_pose
from runtime.recordings.recording import Options
from runtime.recordings.scan_files import ScanFiles, of_files
from runtime.recordings.trajectory import poses_at

log = logging.getLogger("lidar_mos.recordings")

TITLE = "a drive of Argoverse 2"
POSES = "city_SE3_egovehicle.feather"
MOUNTS = Path("calibration", "egovehicle_SE3_sensor.feather")
SWEEPS = Path("sensors", "lidar")
LIDAR = "up_lidar"  # the upper of two, of 32 lasers each, whose points are one sweep
USUAL_PLACE = (1.35, 0.0, 1.64)  # m, of the upper LiDAR in the frame of the vehicle, where no calibration is there


def find(path: Path) -> list[Path]:
    """Folders with the poses of a drive: `path`, or the one of which it is `sensors/lidar`, or those in it."""
    if not path.is_dir():
        return []
    above = path.parent.parent
    if path == above / SWEEPS and (above / POSES).is_file():
        return [above]
    if (path / POSES).is_file():
        return [path]
    return [folder for folder in sorted(path.iterdir()) if (folder / POSES).is_file()]


def open_at(path: Path, options: Options) -> ScanFiles:
    """The drive in the folder `path`. Raises SequenceError, PoseError, MissingPackageError."""
    folder = path / SWEEPS if (path / SWEEPS).is_dir() else path
    files = sorted((file for file in folder.glob("*.feather") if file.stem.isdigit()), key=lambda file: int(file.stem))
    if not files:
        raise SequenceError(f"{folder}: holds no sweeps, NUMBER.feather")
    used = tuple(files[: options.limit])
    times = np.array([int(file.stem) / 1e9 for file in used])
    log.info("%s: its points are those of two LiDARs, taken as if the upper one had seen them all", path)
    mount, found = _mount(path), None
    if options.extrinsics and not options.poses:
        raise SettingError(f"{path}: says itself where its LiDAR sits: leave out `extrinsics`")
    if options.poses and options.reads_poses:
        found = read_file_poses(path, used, replace(options, frame=options.frame or "lidar"), times)
    elif options.reads_poses:
        found = _poses(path, used, times, mount, options)
    return of_files(path, used, options, found, None if options.points_only else times, mount, compensated=True)


def _poses(path: Path, files: tuple[Path, ...], times: Times, mount: Pose, options: Options) -> ScanPoses:
    """The poses of the LiDAR on the vehicle, whose own are kept. Raises PoseError."""
    source = path / POSES
    columns = _read(source, ["timestamp_ns", "tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw"])
    vehicle, broken = poses_at(
        times, columns[:, 0] / 1e9, from_quaternions(columns[:, 1:4], columns[:, 4:]), str(source)
    )
    names = [f"{source}: pose of {file.name}" for file in files]
    poses, broken = checked(vehicle @ mount, broken, names, options.skip_broken)
    return ScanPoses(poses, broken, POSES, partial(_others, vehicle, mount))


def _others(vehicle: Poses, mount: Pose) -> dict[str, Poses]:
    """See `Indexed.other_poses`."""
    return {"inverse": np.linalg.inv(vehicle) @ mount}


def _mount(path: Path) -> Pose:
    """T_vehicle_lidar, of the calibration of the drive or as usual. Raises PoseError."""
    file = path / MOUNTS
    if file.is_file():
        names = list(read_columns(file)["sensor_name"])
        if LIDAR in names:
            row = _read(file, ["tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw"])[[names.index(LIDAR)]]
            return check_pose(from_quaternions(row[:, :3], row[:, 3:])[0], f"{file}: {LIDAR}")
    usual = np.eye(4)
    usual[:3, 3] = USUAL_PLACE
    return usual


def _read(file: Path, names: list[str]) -> npt.NDArray[np.float64]:
    """These columns (T, C) of a file. Raises PoseError."""
    try:
        columns = read_columns(file)
        return np.stack([np.asarray(columns[name], np.float64) for name in names], 1)
    except (ScanError, KeyError, ValueError) as error:
        raise PoseError(f"{file}: cannot be read as poses of Argoverse 2: {error}") from error

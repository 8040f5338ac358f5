"""Recordings of Ouster's LiDARs: OSF, and captured packets (.pcap) beside the JSON of their sensor (extra `ouster`)."""

import weakref
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from runtime.compute.packages import OUSTER, need_package
from runtime.errors import NoPosesError, PoseError, ScanError, SequenceError
from runtime.recordings.cloud import Cloud
from runtime.recordings.pcap import count_packets, is_pcap, is_velodyne
from runtime.recordings.pose_files import ScanPoses, checked, read_file_poses
from runtime.recordings.poses import Pose, Poses
from runtime.recordings.recording import Indexed, Options, Scan
from runtime.recordings.remission import FIRST, Remission
from runtime.sensors.registry import SENSORS

TITLE = "a recording of Ouster (.osf, .pcap)"
OSF = ".osf"
RANGE, REMISSION = "RANGE", "REFLECTIVITY"
IN_FILE = "the file itself"


def find(path: Path) -> list[Path]:
    """`path`, if it is such a file, or those in it."""
    if path.is_dir():
        return [one for file in sorted(path.iterdir()) if file.is_file() for one in find(file)]
    return [path] if _is_osf(path) or (is_pcap(path) and not is_velodyne(path)) else []


def open_at(path: Path, options: Options) -> "OusterRecording":
    """Raises SequenceError, PoseError, MissingPackageError."""
    need_package(OUSTER, f"{path}: a recording of Ouster")
    return OusterRecording(path, options)


class OusterRecording(Indexed):
    """Points row by row of the range image as the sensor sends it, those without a return too, at the origin.

    They are in the frame of the sensor, x forward, but for its origin, which is that of the beams.
    """

    def __init__(self, path: Path, options: Options) -> None:
        """Reads through the file once, for times and poses, without points. Raises SequenceError, PoseError."""
        from ouster.sdk.core import XYZLut

        self.name, self.source = path.stem, str(path)
        packets = None if _is_osf(path) else count_packets(path)
        heads = _open(path, [])
        if len(heads.sensor_info) != 1:
            names = ", ".join(str(info.sn) for info in heads.sensor_info) or "none that is readable; was it cut off?"
            raise SequenceError(f"{path}: must be of one sensor, and its sensors are {names}")
        (info,) = heads.sensor_info
        count = min(len(heads), options.limit or len(heads))
        if not count:
            known = "" if packets is None else f", but {packets} packets; is {_metadata(path).name} theirs?"
            raise SequenceError(f"{path}: holds no whole scan{known}")
        model = info.prod_line.lower().replace("os-", "os")  # as OS-1-128
        self.sensor = model if model in SENSORS else None
        self.keys = tuple(f"{index:06d}" for index in range(count))
        self._shift = info.lidar_to_sensor_transform[:3, 3] / 1000  # m, of the beams in the frame of the sensor
        self._points_of = XYZLut(info, False)
        begins = [_begin(frames[0]) for frames in islice(heads, count)]
        self._times = np.array([time for time, _ in begins])
        self.times = None if options.points_only else self._times
        self._poses = None
        if options.reads_poses:
            self._poses = self._read_poses(path, np.array([pose for _, pose in begins]), info.sensor_to_body, options)
        self.poses = None if self._poses is None else self._poses.poses
        self.poses_from = None if self._poses is None else self._poses.origin
        self._remission = Remission(options.remission_scale, self.source, self._first)
        heads.close()
        self._frames = _open(path, [RANGE, REMISSION])
        weakref.finalize(self, self._frames.close)

    def scans(self, start: int = 0) -> Iterator[Scan]:
        if start < len(self):
            for index, frames in enumerate(self._frames[start : len(self)], start):
                yield self._scan(index, frames[0])

    def read(self, index: int) -> Scan:
        return self._scan(index, self._frames[index][0])

    def remission_scale(self) -> float | None:
        return self._remission.scale

    def count(self, index: int) -> int:
        (info,) = self._frames.sensor_info
        return int(info.w * info.h)

    def other_poses(self) -> dict[str, Poses]:
        return {} if self._poses is None else self._poses.others()

    def _scan(self, index: int, frame: Any) -> Scan:
        if self._poses is not None and index in self._poses.broken:
            raise PoseError(self._poses.broken[index])
        if _begin(frame)[0] != self._times[index]:
            raise ScanError(f"{self.source}: scan {self.keys[index]}: another one was found in its place by its time")
        cloud = self._cloud(frame)
        return Scan(
            self.keys[index],
            self._remission.scaled(cloud.data),
            None if self.poses is None else self.poses[index],
            None if self.times is None else float(self.times[index]),
            cloud.ring,
            _seconds(frame),
        )

    def _cloud(self, frame: Any) -> Cloud:
        """The points of a frame. Raises ScanError where it has no ranges."""
        if RANGE not in frame.fields:
            raise ScanError(f"{self.source}: has no field {RANGE}; its fields are {', '.join(frame.fields)}")
        points = self._points_of(frame) - self._shift
        points[frame.field(RANGE) == 0] = 0
        columns = [points.reshape(-1, 3)]
        if REMISSION in frame.fields:
            columns.append(frame.field(REMISSION).reshape(-1, 1))
        return Cloud(np.hstack(columns, dtype=np.float32), np.repeat(np.arange(frame.h, dtype=np.int32), frame.w))

    def _first(self) -> Iterator[Cloud]:
        return (self._cloud(self._frames[index][0]) for index in range(min(FIRST, len(self))))

    def _read_poses(self, path: Path, bodies: Poses, sensor: Pose, options: Options) -> ScanPoses:
        """From the file that is named, else those within: of the body, in which the sensor sits."""
        if options.poses is not None:
            scans = tuple(path / key for key in self.keys)
            given = replace(options, frame=options.frame or (None if options.calib else "lidar"), limit=None)
            return read_file_poses(path.parent, scans, given, self._times)
        if np.array_equal(bodies, np.broadcast_to(np.eye(4), bodies.shape)):
            raise NoPosesError(
                f"{path}: no poses: there is none within; name a file of them (`poses`), or find them "
                f"(`odometry='kiss'`)"
            )
        mount = sensor.copy()
        mount[:3, 3] += sensor[:3, :3] @ self._shift
        poses, broken = checked(bodies @ mount, {}, [f"{path}: scan {key}" for key in self.keys], options.skip_broken)
        return ScanPoses(poses, broken, IN_FILE, partial(_others, bodies, mount))


def _others(bodies: Poses, mount: Pose) -> dict[str, Poses]:
    """See `Indexed.other_poses`."""
    return {"inverse": np.linalg.inv(bodies) @ mount}


def _open(path: Path, fields: list[str]) -> Any:
    """The frames of a file, with these fields. Raises SequenceError."""
    from ouster.sdk import open_source

    meta = {} if _is_osf(path) else {"meta": [str(_metadata(path))]}
    try:
        return open_source(str(path), field_names=fields, index=True, **meta)
    except Exception as error:  # of the SDK and of what it reads with: there is no common base
        reason = str(error).partition("more details:")[2] or str(error)
        raise SequenceError(f"{path}: cannot be read as {TITLE}: {' '.join(reason.split())}") from error


def _is_osf(path: Path) -> bool:
    return path.suffix.lower() == OSF and path.is_file()


def _metadata(path: Path) -> Path:
    """The JSON beside a .pcap whose name begins as its own does, or the other way round. Raises SequenceError."""
    beside = [file for file in path.parent.iterdir() if file.suffix.lower() == ".json"]
    alike = [one for one in beside if path.stem.startswith(one.stem) or one.stem.startswith(path.stem)]
    if not alike:
        raise SequenceError(
            f"{path}: needs the metadata of its sensor, a JSON of the same name beside it (`ouster-cli source HOST "
            f"metadata`); if its packets are not those of an Ouster sensor, play them to its driver"
        )
    return max(alike, key=lambda one: len(one.stem))


def _begin(frame: Any) -> tuple[float, Pose]:
    """Time in s and pose of the body at the first column that is there."""
    column = max(0, frame.get_first_valid_column())
    return 1e-9 * float(frame.timestamp[column]), np.array(frame.body_to_world[column], np.float64)


def _seconds(frame: Any) -> npt.NDArray[np.float32]:
    """When each point was measured, (N,) s after the first column."""
    times = frame.timestamp.astype(np.int64)
    seconds = np.where(frame.status & 1, times - times[max(0, frame.get_first_valid_column())], 0) * 1e-9
    return np.tile(seconds.astype(np.float32), frame.h)

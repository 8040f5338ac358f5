"""Captured packets of Velodyne's LiDARs (.pcap; extra `velodyne`)."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from runtime.compute.packages import VELODYNE as PACKAGE
from runtime.compute.packages import need_package
from runtime.errors import NoPosesError, PoseError, ScanError, SequenceError
from runtime.recordings.cloud import Cloud
from runtime.recordings.pcap import VELODYNE, is_pcap, is_velodyne, packets
from runtime.recordings.pose_files import ScanPoses, Times, read_file_poses
from runtime.recordings.poses import Poses
from runtime.recordings.recording import Indexed, Options, Scan
from runtime.recordings.remission import FIRST, Remission
from runtime.sensors.registry import SENSORS

TITLE = "packets of Velodyne (.pcap)"
BACK, ROUND = 18000, 36000  # hundredths of a degree: where one turn ends and the next begins
FEWEST = 20  # packets of a turn; the quickest, of 16 lasers, has 38


def find(path: Path) -> list[Path]:
    """`path`, if it is such a file, or those in it."""
    if path.is_dir():
        return [file for file in sorted(path.iterdir()) if is_pcap(file) and is_velodyne(file)]
    return [path] if is_pcap(path) and is_velodyne(path) else []


def open_at(path: Path, options: Options) -> "VelodyneRecording":
    """Raises SequenceError, PoseError, MissingPackageError."""
    need_package(PACKAGE, f"{path}: packets of Velodyne")
    return VelodyneRecording(path, options)


class VelodyneRecording(Indexed):
    """Turns from back to back, of points that have a return; their time is that at which the last packet came."""

    def __init__(self, path: Path, options: Options) -> None:
        """Reads through the file once, for where turns begin. Raises SequenceError, PoseError."""
        self.name, self.source, self._path = path.stem, str(path), path
        self._edges, ends = _turns(path, options.limit)
        self._config = _config(path)
        self.keys = tuple(f"{index:06d}" for index in range(len(ends)))
        self.times = None if options.points_only else ends
        self._poses = self._read_poses(options, ends) if options.reads_poses else None
        self.poses = None if self._poses is None else self._poses.poses
        self.poses_from = None if self._poses is None else self._poses.origin
        self._remission = Remission(options.remission_scale, self.source, self._first)
        self.sensor = self._sensor()

    def remission_scale(self) -> float | None:
        return self._remission.scale

    def read(self, index: int) -> Scan:
        if self._poses is not None and index in self._poses.broken:
            raise PoseError(self._poses.broken[index])
        cloud, times, _ = self._decoded(index)
        return Scan(
            self.keys[index],
            self._remission.scaled(cloud.data),
            None if self.poses is None else self.poses[index],
            None if self.times is None else float(self.times[index]),
            cloud.ring,
            times,
        )

    def other_poses(self) -> dict[str, Poses]:
        return {} if self._poses is None else self._poses.others()

    def _decoded(self, index: int) -> tuple[Cloud, npt.NDArray[np.float32], str]:
        """The points of a turn, their times, (N,) s after that of the turn, and the model. Raises ScanError."""
        import velodyne_decoder as velodyne

        begin, end = self._edges[index : index + 2]
        sent = takewhile(lambda packet: packet.at < end, packets(self._path, begin))
        turn = [velodyne.VelodynePacket(one.time, one.payload) for one in sent if one.size == VELODYNE]
        decoder = velodyne.ScanDecoder(self._config)
        try:
            points = np.asarray(decoder.decode(velodyne.PacketVector(turn), False)[1])
        except Exception as error:  # of the decoder, which has no base of its own
            raise ScanError(f"{self.source}: scan {self.keys[index]}: cannot be decoded: {error}") from error
        columns = velodyne.PointField
        cloud = Cloud(np.ascontiguousarray(points[:, :4]), points[:, columns.ring].astype(np.int32))
        return cloud, np.ascontiguousarray(points[:, columns.time]), decoder.model_id.name

    def _first(self) -> Iterator[Cloud]:
        for index in range(min(FIRST, len(self))):
            with suppress(ScanError):  # is said when it is read
                yield self._decoded(index)[0]

    def _sensor(self) -> str | None:
        with suppress(ScanError):
            model = self._decoded(0)[2].lower()
            return model if model in SENSORS else None
        return None

    def _read_poses(self, options: Options, times: Times) -> ScanPoses:
        if options.poses is None:
            raise NoPosesError(
                f"{self.source}: no poses: packets hold none; name a file of them (`poses`), or find them "
                f"(`odometry='kiss'`)"
            )
        scans = tuple(self._path / key for key in self.keys)
        given = replace(options, frame=options.frame or (None if options.calib else "lidar"), limit=None)
        return read_file_poses(self._path.parent, scans, given, times)


def _turns(path: Path, limit: int | None) -> tuple[list[int], Times]:
    """Bytes at which turns begin, and at which the last one ends; times (T,) s of their last packets.

    Raises SequenceError where there is no turn, or several sensors sent them.
    """
    edges, ends, senders = list[int](), list[float](), set[bytes]()
    count, last, end, time = 0, ROUND, 0, 0.0
    for packet in packets(path):
        if packet.size != VELODYNE:
            continue
        angle = (int.from_bytes(packet.payload[2:4], "little") - BACK) % ROUND  # of the first of its twelve columns
        if angle < last:
            if edges:
                ends.append(time)
            edges.append(packet.at)
            if limit is not None and len(ends) == limit:
                break
        count, last, end, time = count + 1, angle, packet.at + 1, packet.time
        senders.add(packet.sender)
    else:
        edges, ends = [*edges, end], [*ends, time]
    if len(senders) > 1:
        names = ", ".join(".".join(map(str, sender)) for sender in sorted(senders))
        raise SequenceError(f"{path}: holds packets of several sensors, {names}; keep those of one")
    if count < FEWEST:
        raise SequenceError(f"{path}: holds no whole scan, but {count} packets")
    return edges, np.array(ends)


def _config(path: Path) -> Any:
    """How to decode: the HDL-64E sends its calibration along, the others have one a model. Raises SequenceError."""
    import velodyne_decoder as velodyne

    try:
        model, calibration = velodyne.hdl64e.detect_hdl64e(str(path))
    except ValueError as error:
        raise SequenceError(f"{path}: is of an HDL-64E, whose calibration is not found in it: {error}") from error
    return velodyne.Config(model=model, calibration=calibration)

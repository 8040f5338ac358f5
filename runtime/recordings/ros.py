"""Recordings of ROS: bags of ROS 1, and of ROS 2 in SQLite (.db3) or MCAP (extra `ros`)."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import PoseError, ScanError, SettingError
from runtime.recordings.bag import Bag, Message, is_bag
from runtime.recordings.bag_copy import Edit, copy_bag
from runtime.recordings.cloud import Cloud
from runtime.recordings.point_times import PointTimes
from runtime.recordings.pointcloud2 import to_cloud
from runtime.recordings.pointcloud2_edits import ADDED, with_labels, without
from runtime.recordings.pose_files import ScanPoses, Times, read_file_poses
from runtime.recordings.poses import Poses
from runtime.recordings.recording import Indexed, Options, Scan
from runtime.recordings.remission import FIRST, Remission
from runtime.recordings.ros_poses import read_topic_poses
from runtime.recordings.ros_stamps import Stamps
from runtime.recordings.ros_topics import CLOUD, choose_topic, warn_of_changed

TITLE = "a bag of ROS 1 or 2 (.bag, .db3, .mcap)"


def find(path: Path) -> list[Path]:
    """`path`, if it is a bag, or those in it."""
    if is_bag(path):
        return [path]
    return [one for one in sorted(path.iterdir()) if is_bag(one)] if path.is_dir() else []


def open_at(path: Path, options: Options) -> "RosRecording":
    """The clouds of one topic of the bag at `path`. Raises SequenceError, PoseError, MissingPackageError."""
    return RosRecording(Bag(path), options)


class RosRecording(Indexed):
    """The clouds of one topic. They are read one by one: none but the stamps are kept."""

    sensor = None

    def __init__(self, bag: Bag, options: Options) -> None:
        """Reads through the bag once, for the stamps. Raises SequenceError, PoseError."""
        path = bag.path
        self.name, self.source = path.stem if path.is_file() else path.name, str(path)
        self._bag, self._topic = bag, choose_topic(bag, CLOUD, options.topic)
        self._stamps = Stamps.of(bag, self._topic, options.limit)
        warn_of_changed(self.source, self._topic, self._stamps.frame)
        self.keys = tuple(f"{index:06d}" for index in range(len(self._stamps.counts)))
        self.times = None if options.points_only else self._stamps.times
        self._poses = self._read_poses(options) if options.reads_poses else None
        self.poses = None if self._poses is None else self._poses.poses
        self.poses_from = None if self._poses is None else self._poses.origin
        self._remission = Remission(options.remission_scale, self.source, self._first)
        self._point_times = PointTimes(self.source, self._first)

    def scans(self, start: int = 0) -> Iterator[Scan]:
        if start < len(self):
            for index, message in enumerate(islice(self._messages(start), len(self) - start), start):
                yield self._scan(index, message)

    def read(self, index: int) -> Scan:
        return self._scan(index, next(self._messages(index)))

    def remission_scale(self) -> float | None:
        return self._remission.scale

    def count(self, index: int) -> int:
        return self._stamps.counts[index]

    def write_kept(self, folder: Path, kept: Iterator[tuple[int, npt.NDArray[np.bool_]]]) -> None:
        def left(keep: npt.NDArray[np.bool_]) -> Edit:
            return lambda cloud, _: without(cloud, keep)

        copy_bag(self._bag, self._topic, folder, ((index, left(keep)) for index, keep in kept))

    def check_takes_labels(self) -> None:
        message = next(self._messages(0))
        for name in (one.name for one in self._bag.decoded(message, CLOUD, self.source).fields):
            if name in ADDED:
                raise SettingError(
                    f"{self.source}: its clouds have a field {name} already; give the bag without labels"
                )

    def write_labelled(
        self, folder: Path, labelled: Iterator[tuple[int, npt.NDArray[np.bool_], npt.NDArray[np.float32]]]
    ) -> None:
        def told(moving: npt.NDArray[np.bool_], probability: npt.NDArray[np.float32]) -> Edit:
            return lambda cloud, where: with_labels(cloud, moving, probability, where)

        copy_bag(
            self._bag,
            self._topic,
            folder,
            ((index, told(moving, probability)) for index, moving, probability in labelled),
        )

    def other_poses(self) -> dict[str, Poses]:
        return {} if self._poses is None else self._poses.others()

    def _messages(self, start: int) -> Iterator[Message]:
        """Those of the clouds from number `start` on. Raises ScanError where they cannot be read."""
        try:
            yield from self._bag.messages(self._topic, *self._stamps.place(start))
        except ScanError as error:
            raise ScanError(f"{self.source}: scan {self.keys[start]} or one after it: {error}") from error
        raise ScanError(f"{self.source}: ends before its {len(self)} scans")

    def _scan(self, index: int, message: Message) -> Scan:
        if self._poses is not None and index in self._poses.broken:
            raise PoseError(self._poses.broken[index])
        cloud = self._cloud(index, message)
        time = None if self.times is None else float(self.times[index])
        return Scan(
            self.keys[index],
            self._remission.scaled(cloud.data),
            None if self.poses is None else self.poses[index],
            time,
            cloud.ring,
            self._point_times.seconds(cloud.times, time),
        )

    def _cloud(self, index: int, message: Message) -> Cloud:
        where = f"{self.source}: scan {self.keys[index]} of {self._topic}"
        return to_cloud(self._bag.decoded(message, CLOUD, where), where)

    def _first(self) -> Iterator[Cloud]:
        for index, message in enumerate(islice(self._messages(0), min(FIRST, len(self)))):
            try:
                yield self._cloud(index, message)
            except ScanError:  # is said when it is read
                continue

    def _read_poses(self, options: Options) -> ScanPoses:
        """From the file or topic that is named, or the only topic that has those of the points' frame."""
        times: Times = self._stamps.times if self.times is None else np.asarray(self.times)
        if options.poses is None:
            return read_topic_poses(self._bag, times, self._stamps.frame, options)
        frame = options.frame or (None if options.calib else "lidar")
        scans = tuple(self._bag.path / key for key in self.keys)
        return read_file_poses(self._bag.path.parent, scans, replace(options, frame=frame, limit=None), times)

"""Poses of the scans of a bag: from its odometry, its TF, or a topic that is named."""

import logging
import warnings
from collections.abc import Iterator
from functools import cached_property, partial
from typing import Any

import numpy as np

from runtime.errors import MosWarning, NoPosesError, PoseError, SequenceError, SettingError
from runtime.recordings.bag import Bag, Message
from runtime.recordings.extrinsics import mounted, read_extrinsics
from runtime.recordings.pose_files import ScanPoses, Times, checked
from runtime.recordings.pose_table import from_quaternions
from runtime.recordings.poses import Pose, Poses
from runtime.recordings.recording import Options
from runtime.recordings.ros_tf import Frames, plain, tf_topics
from runtime.recordings.ros_topics import listed
from runtime.recordings.trajectory import poses_at

log = logging.getLogger("lidar_mos.recordings")

ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"


def read_topic_poses(bag: Bag, times: Times, frame: str, options: Options) -> ScanPoses:
    """The poses of the scans at `times` (T,) s, whose points are in `frame`.

    From `options.pose_topic`; from TF where `options.world` names its frame; else from the only odometry of that frame;
    else from TF; else from the only odometry of a frame against which that one sits still, by TF or
    `options.extrinsics`. Raises PoseError, SequenceError, SettingError, ScanError; warns (MosWarning) where the poses
    are those of another frame.
    """
    sources = _Sources(bag, plain(frame), options)
    topic = sources.choose() if options.pose_topic is None else options.pose_topic
    if topic in sources.transforms:
        raw, broken, mount, origin = sources.of_tf(times)
    elif topic in sources.kinds and sources.world is not None:
        raise SettingError(f"`world` is a frame of TF, and {topic} (`pose_topic`) is not: leave out one of the two")
    elif topic in sources.kinds:
        raw, broken, mount, origin = sources.of_topic(topic, times)
    else:
        raise SequenceError(f"{bag.path}: has no poses on {topic} (`pose_topic`); {sources.listed}")
    names = [f"{bag.path}: {topic}: pose at {time:.3f} s" for time in times]
    poses, broken = checked(raw @ mount, broken, names, options.skip_broken)
    return ScanPoses(poses, broken, origin, partial(_others, raw, mount))


def _others(raw: Poses, mount: Pose) -> dict[str, Poses]:
    """See `Indexed.other_poses`."""
    return {"inverse": np.linalg.inv(raw) @ mount}


class _Sources:
    """What a bag has of poses, and where the LiDAR sits in their frames."""

    def __init__(self, bag: Bag, frame: str, options: Options) -> None:
        self.bag, self.frame = bag, frame
        self.kinds = {
            topic: kind for topic, (kind, count) in bag.topics().items() if kind in (ODOMETRY, POSE) and count
        }
        self.transforms = tf_topics(bag)
        self.world = None if options.world is None else plain(options.world)
        self.listed = listed(bag, [*self.kinds, *self.transforms])
        self.given = None if options.extrinsics is None else read_extrinsics(options.extrinsics)
        self.moved = "" if options.extrinsics is None else f", {mounted(options.extrinsics)}"

    def choose(self) -> str:
        """The topic of the poses. Raises NoPosesError where there is none, PoseError where there are several."""
        if self.world is not None:
            if not self.transforms:
                raise PoseError(f"{self.bag.path}: has no TF in which {self.world} could be (`world`); {self.listed}")
            return self.transforms[0]
        odometry = {topic: self._body(topic) for topic, kind in self.kinds.items() if kind == ODOMETRY}
        fit = [topic for topic, body in odometry.items() if body == self.frame and self.given is None]
        why = ""
        if len(fit) != 1 and self.transforms:
            why = self.frames.missing(self._sensor)
            if not why:
                return self.transforms[0]
        if not fit:
            fit = [topic for topic, body in odometry.items() if self._mount(body) is not None]
        if len(fit) == 1:
            log.info("%s: the poses are those of %s", self.bag.path, fit[0])
            return fit[0]
        advice = "name a file of them (`poses`) or a topic (`pose_topic`), or find them (`odometry='kiss'`)"
        text = f"{self.bag.path}: no poses: {advice}; {self.listed}{why and f'. {why}'}"
        if self.kinds:
            raise PoseError(text)
        if why:
            log.info("%s", why)
        raise NoPosesError(text)

    def of_tf(self, times: Times) -> tuple[Poses, dict[int, str], Pose, str]:
        """Poses at `times` (T,) s, those that are not known, T_body_lidar, and the origin. Raises PoseError."""
        sensor = self._sensor
        if sensor is None or self.frames.missing(sensor):
            raise PoseError(self.frames.missing(sensor))
        world = self.frames.world(sensor)
        origin = f"{' and '.join(self.transforms)} from {world} to {sensor}{self.moved}"
        above = self.frames.chain(world)[1:]
        log.info(
            "%s: the poses are those of %s%s",
            self.bag.path,
            origin,
            f"; above it is {above[-1]} (`world`)" if above else "",
        )
        return *self.frames.poses(world, sensor, times), np.eye(4) if self.given is None else self.given, origin

    def of_topic(self, topic: str, times: Times) -> tuple[Poses, dict[int, str], Pose, str]:
        """The same, of odometry or poses."""
        body, origin = self._body(topic), f"{topic}{self.moved}"
        mount = self._mount(body)
        if mount is None:
            warnings.warn(
                f"{self.bag.path}: the poses of {topic} are those of {body or 'a frame without a name'}, the points "
                f"are in {self.frame}: they are taken as if both were the same (`extrinsics`)",
                MosWarning,
                stacklevel=2,
            )
        elif body != self.frame and self.given is None:
            origin += f", {self.frame} in {body} by TF"
            log.info("%s: the points are those of %s", self.bag.path, origin)
        rows = np.array(list(self._rows(topic)))
        poses = from_quaternions(rows[:, 1:4], rows[:, 4:])
        return (
            *poses_at(times, rows[:, 0], poses, f"{self.bag.path}: {topic}"),
            np.eye(4) if mount is None else mount,
            origin,
        )

    @cached_property
    def frames(self) -> Frames:
        return Frames.of(self.bag, self.world)

    @property
    def _sensor(self) -> str | None:
        """The frame whose poses TF is to give: that of the points, or the one in which the LiDAR is said to sit."""
        return self.frame if self.given is None else self.frames.body()

    def _mount(self, body: str) -> Pose | None:
        """T_body_lidar; None where it is not known."""
        if self.given is not None:
            return self.given
        if body == self.frame:
            return np.eye(4)
        return self.frames.mount(body, self.frame) if self.transforms and body else None

    def _body(self, topic: str) -> str:
        """Of which frame the poses are; "" where the messages do not say."""
        first = self._decoded(topic, next(self._messages(topic)))
        return plain(str(first.child_frame_id)) if self.kinds[topic] == ODOMETRY else ""

    def _rows(self, topic: str) -> Iterator[tuple[float, ...]]:
        """Time in s, position and quaternion x y z w of each message."""
        for message in self._messages(topic):
            content = self._decoded(topic, message)
            stamp, pose = content.header.stamp, content.pose.pose if self.kinds[topic] == ODOMETRY else content.pose
            time = stamp.sec + 1e-9 * stamp.nanosec
            place, turn = pose.position, pose.orientation
            yield (time or 1e-9 * message.received, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)

    def _messages(self, topic: str) -> Iterator[Message]:
        """One at least. Raises PoseError, and ScanError where the bag is broken."""
        message = None
        for message in self.bag.messages(topic):
            yield message
        if message is None:
            raise PoseError(f"{self.bag.path}: counts messages of {topic}, but holds none: it is damaged")

    def _decoded(self, topic: str, message: Message) -> Any:
        return self.bag.decoded(message, self.kinds[topic], f"{self.bag.path}: {topic}")

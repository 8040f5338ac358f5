"""Poses of scans from what a running system says: TF, or odometry on a topic."""

import time
import warnings
from array import array
from threading import Condition
from typing import Any

import numpy as np

from runtime.errors import MosWarning, PoseError
from runtime.recordings.extrinsics import read_extrinsics
from runtime.recordings.pose_table import from_quaternions
from runtime.recordings.poses import Pose, check_pose
from runtime.recordings.recording import Options
from runtime.recordings.ros_tf import ROW, Frames, Transforms, plain
from runtime.recordings.trajectory import poses_at

KEPT = 10.0  # s of poses
PATIENCE = 0.2  # s that a scan waits for a pose of its time or later


class PoseFeed:
    """What is said of poses, by the thread that receives it, and which a scan has, for the thread that labels."""

    def __init__(self, options: Options, patience: float = PATIENCE) -> None:
        """options: `pose_topic` of odometry, None: TF; `world`; `extrinsics`. patience: s. Raises SettingError."""
        self._topic, self._world = options.pose_topic, None if options.world is None else plain(options.world)
        self._given = None if options.extrinsics is None else read_extrinsics(options.extrinsics)
        self._patience = patience
        self._changed = Condition()
        self._transforms = Transforms(KEPT)
        self._rows, self._body = array("d"), ""

    def add_transforms(self, content: Any, static: bool) -> None:
        """A TFMessage. static: of the topic whose transforms hold for ever."""
        with self._changed:
            self._transforms.add(content, time.time_ns(), static)
            self._changed.notify_all()

    def add_odometry(self, content: Any) -> None:
        """An Odometry."""
        stamp, pose = content.header.stamp, content.pose.pose
        place, turn = pose.position, pose.orientation
        seconds = stamp.sec + 1e-9 * stamp.nanosec
        with self._changed:
            if self._rows and not seconds - KEPT <= self._rows[-ROW] <= seconds + KEPT:
                del self._rows[:]  # of a recording that is played once more, say
            elif len(self._rows) and seconds - self._rows[0] > 2 * KEPT:
                table = np.array(self._rows).reshape(-1, ROW)
                self._rows = array("d", table[table[:, 0] >= seconds - KEPT].ravel())
            self._rows.extend((seconds, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))
            self._body = plain(content.child_frame_id)
            self._changed.notify_all()

    def missing(self, frame: str) -> str:
        """Why there are no poses of the points' frame; "" where there are."""
        with self._changed:
            if self._topic is not None:
                return "" if self._rows else f"nothing came on {self._topic} (`pose_topic`)"
            frames = self._frames()
            return frames.missing(self._sensor(frames, frame))

    def pose(self, frame: str, seconds: float) -> Pose:
        """T_world_lidar (4, 4) of points in `frame` at a time. Raises PoseError where it is not known.

        It waits for a pose of that time or later; where none comes, the motion goes on as it is, see `poses_at`.
        """
        frame, end = plain(frame), time.monotonic() + self._patience
        with self._changed:
            while not self._latest(frame) >= seconds and (left := end - time.monotonic()) > 0:
                self._changed.wait(left)
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", ".*the motion goes on", MosWarning)
                return self._of_topic(frame, seconds) if self._topic else self._of_tf(frame, seconds)

    def origin(self, frame: str) -> str:
        """What the poses are read from, in words."""
        if self._topic is not None:
            return f"{self._topic}, of {self._body or 'a frame without a name'}"
        frames = self._frames()
        sensor = self._sensor(frames, plain(frame))
        assert sensor is not None
        return f"TF from {frames.world(sensor)} to {sensor}"

    def _latest(self, frame: str) -> float:
        """s, up to when poses are known."""
        if self._topic is not None:
            return self._rows[-ROW] if self._rows else -np.inf
        frames = self._frames()
        sensor = self._sensor(frames, frame)
        if sensor is None or frames.missing(sensor):
            return -np.inf
        chain = frames.chain(sensor)
        links = [frames.links[one] for one in chain[: chain.index(frames.world(sensor))]]
        return min((float(link.times[-1]) for link in links if not link.fixed), default=np.inf)

    def _of_tf(self, frame: str, seconds: float) -> Pose:
        frames = self._frames()
        sensor = self._sensor(frames, frame)
        if sensor is None or frames.missing(sensor):
            raise PoseError(frames.missing(sensor))
        found, why = frames.poses(frames.world(sensor), sensor, np.array([seconds]))
        return self._checked(found[0], why, np.eye(4) if self._given is None else self._given)

    def _of_topic(self, frame: str, seconds: float) -> Pose:
        if not self._rows:
            raise PoseError(self.missing(frame))
        table = np.array(self._rows).reshape(-1, ROW)
        poses = from_quaternions(table[:, 1:4], table[:, 4:])
        found, why = poses_at(np.array([seconds]), table[:, 0], poses, str(self._topic))
        mount = self._given
        if mount is None and self._body and self._body != frame:
            mount = self._frames().mount(self._body, frame)
            if mount is None:
                raise PoseError(
                    f"{self._topic}: its poses are those of {self._body}, the points are in {frame}, and no TF says "
                    "how they lie to each other (`extrinsics`)"
                )
        return self._checked(found[0], why, np.eye(4) if mount is None else mount)

    def _checked(self, pose: Pose, why: dict[int, str], mount: Pose) -> Pose:
        if why:
            raise PoseError(why[0])
        return check_pose(pose @ mount, "pose")

    def _frames(self) -> Frames:
        return self._transforms.frames("TF", self._world)

    def _sensor(self, frames: Frames, frame: str) -> str | None:
        """The frame whose poses TF is to give, as `ros_poses` has it."""
        return plain(frame) if self._given is None else frames.body()

"""Which topic of a bag holds what, and poses from one of them."""

import logging
import warnings
from collections.abc import Iterator

import numpy as np

from runtime.errors import MosWarning, PoseError, SequenceError, some
from runtime.recordings.bag import Bag
from runtime.recordings.pose_files import ScanPoses, Times, checked
from runtime.recordings.pose_table import from_quaternions
from runtime.recordings.poses import Poses
from runtime.recordings.recording import Options
from runtime.recordings.trajectory import poses_at

log = logging.getLogger("lidar_mos.recordings")

CLOUD = "sensor_msgs/msg/PointCloud2"
ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
DRIVER = "the driver that recorded it, which gives PointCloud2 when the bag is played"
PACKETS = {  # messages of drivers: whose they are, and what decodes them, by how their type begins
    "ouster": ("packets of an Ouster driver", f"ouster-sdk, or {DRIVER}"),
    "velodyne": ("packets of a Velodyne driver", f"velodyne-decoder, or {DRIVER}"),
    "livox": ("messages of a Livox driver", "livox_ros_driver2 with xfer_format 0, which gives PointCloud2"),
    "hesai": ("packets of a Hesai driver", DRIVER),
    "pandar": ("packets of a Hesai driver", DRIVER),
    "nebula": ("packets of the Nebula driver", DRIVER),
    "rslidar": ("packets of a RoboSense driver", DRIVER),
}


def choose_topic(bag: Bag, kind: str, given: str | None) -> str:
    """The topic that is given, or the only one of this type. Raises SequenceError, listing what there is."""
    topics = bag.topics()
    fit = [topic for topic, (found, count) in topics.items() if found == kind and count]
    if given is not None:
        if given not in fit:
            raise SequenceError(f"{bag.path}: has no {kind} on {given} (`topic`); {_listed(bag, fit)}")
        return given
    if len(fit) > 1:
        raise SequenceError(f"{bag.path}: has several topics of {kind}; name one (`topic`); {_listed(bag, fit)}")
    if fit:
        return fit[0]
    for topic, (found, count) in topics.items():
        for maker, (what, decoder) in PACKETS.items():
            if found.startswith(maker) and count:
                raise SequenceError(
                    f"{bag.path}: holds {what} ({found} on {topic}), no points ({kind}); decode them first: {decoder}"
                )
    raise SequenceError(f"{bag.path}: holds no points ({kind}); {_listed(bag, list(topics))}")


def _listed(bag: Bag, names: list[str]) -> str:
    topics = bag.topics()
    there = [f"{name} ({topics[name][0]}, {topics[name][1]} messages)" for name in names]
    return f"there are {some(there, most=12)}" if there else "there is none"


def read_topic_poses(bag: Bag, times: Times, frame: str, options: Options) -> ScanPoses:
    """The poses of the scans at `times` (T,) s, whose points are in `frame`.

    From `options.pose_topic`, or the only odometry of that frame. Raises PoseError, SequenceError; warns (MosWarning)
    where the poses are those of another frame.
    """
    topics = bag.topics()
    fit = [topic for topic, (kind, count) in topics.items() if kind in (ODOMETRY, POSE) and count]
    if options.pose_topic is None:
        fitting = [topic for topic in fit if topics[topic][0] == ODOMETRY and _frame(bag, topic) == frame]
        if len(fitting) != 1:
            raise PoseError(
                f"{bag.path}: no poses: name a file of them (`poses`) or a topic (`pose_topic`); {_listed(bag, fit)}"
            )
        (topic,) = fitting
        log.info("%s: the poses are those of %s", bag.path, topic)
    else:
        topic = options.pose_topic
        if topic not in fit:
            raise SequenceError(f"{bag.path}: has no poses on {topic} (`pose_topic`); {_listed(bag, fit)}")
    child = _frame(bag, topic)
    if child != frame:
        warnings.warn(
            f"{bag.path}: the poses of {topic} are those of {child or 'a frame without a name'}, the points are in "
            f"{frame}: they are taken as if both were the same",
            MosWarning,
            stacklevel=2,
        )
    rows = np.array(list(_rows(bag, topic)))
    poses, broken = poses_at(times, rows[:, 0], from_quaternions(rows[:, 1:4], rows[:, 4:]), f"{bag.path}: {topic}")
    names = [f"{bag.path}: {topic}: pose at {time:.3f} s" for time in times]
    poses, broken = checked(poses, broken, names, options.skip_broken)

    def others() -> dict[str, Poses]:
        return {"inverse": np.linalg.inv(poses).astype(np.float64)}

    return ScanPoses(poses, broken, topic, others)


def _frame(bag: Bag, topic: str) -> str:
    """Of which frame the poses are; "" where the messages do not say."""
    kind = bag.topics()[topic][0]
    first = bag.decoded(next(bag.messages(topic)), kind, f"{bag.path}: {topic}")
    return str(first.child_frame_id) if kind == ODOMETRY else ""


def _rows(bag: Bag, topic: str) -> Iterator[tuple[float, ...]]:
    """Time in s, position and quaternion x y z w of each message."""
    kind = bag.topics()[topic][0]
    for message in bag.messages(topic):
        content = bag.decoded(message, kind, f"{bag.path}: {topic}")
        stamp, pose = content.header.stamp, content.pose.pose if kind == ODOMETRY else content.pose
        time = stamp.sec + 1e-9 * stamp.nanosec
        place, turn = pose.position, pose.orientation
        yield (time or 1e-9 * message.received, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)

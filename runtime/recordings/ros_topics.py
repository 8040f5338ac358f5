"""Which topic of a bag holds what."""

import re
import warnings

from runtime.errors import MosWarning, SequenceError, some
from runtime.recordings.bag import Bag

CLOUD = "sensor_msgs/msg/PointCloud2"
CHANGED = re.compile(r"concat|merge|combine|fuse|filter|downsample|voxel|crop|no_?ground|deskew|undistort|motion_?comp")
VEHICLE = re.compile(r"(base|body|ego|vehicle|chassis|robot|imu)(_?(link|footprint|frame|vehicle))?|map|odom|world")
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
            raise SequenceError(f"{bag.path}: has no {kind} on {given} (`topic`); {listed(bag, fit)}")
        return given
    if len(fit) > 1:
        raise SequenceError(f"{bag.path}: has several topics of {kind}; name one (`topic`); {listed(bag, fit)}")
    if fit:
        return fit[0]
    for topic, (found, count) in topics.items():
        for maker, (what, decoder) in PACKETS.items():
            if found.startswith(maker) and count:
                raise SequenceError(
                    f"{bag.path}: holds {what} ({found} on {topic}), no points ({kind}); decode them first: {decoder}"
                )
    raise SequenceError(f"{bag.path}: holds no points ({kind}); {listed(bag, list(topics))}")


def listed(bag: Bag, names: list[str]) -> str:
    """Topics with their types, in words."""
    topics = bag.topics()
    there = [f"{name} ({topics[name][0]}, {topics[name][1]} messages)" for name in names]
    return f"there are {some(there, most=12)}" if there else "there is none"


def warn_of_changed(source: str, topic: str, frame: str) -> None:
    """MosWarning where names say that clouds are not those of one LiDAR as it measured them."""
    why = []
    if found := CHANGED.search(topic.lower()):
        why.append(f"{topic} sounds as if its clouds were changed ({found[0]})")
    if VEHICLE.fullmatch(frame.rpartition("/")[2].lower()):
        why.append(f"the points are in {frame}, which is not the frame of a LiDAR")
    if why:
        warnings.warn(
            f"{source}: {' and '.join(why)}: labels are right for the points of one LiDAR, all that it measured, in "
            f"its own frame; choose its own topic where there is one (`topic`)",
            MosWarning,
            stacklevel=2,
        )

"""Which topics a session takes, as soon as they are there."""

import logging
import time
from collections.abc import Callable

from runtime.errors import MosError, SequenceError, some
from runtime.live.clouds import Arrived
from runtime.live.dds import SENSOR, Node, Quality
from runtime.live.newest import Newest
from runtime.live.pose_feed import PoseFeed
from runtime.recordings.bag import TF
from runtime.recordings.ros_poses import ODOMETRY
from runtime.recordings.ros_tf import STATIC
from runtime.recordings.ros_topics import CLOUD

POLL = 0.2  # s, after which it is looked again; discovery takes as long
QUIET = 5.0  # s without anything, after which that is said
MOST = 12  # topics in a message

log = logging.getLogger("lidar_mos.recordings.live")


def find_topic(node: Node, given: str | None, stop: Callable[[], bool]) -> str | None:
    """The topic of clouds that is given, or the only one, as soon as somebody publishes it; None: `stop()` said so.

    What is there instead is said after a while. Raises SequenceError where a topic is of another type, or several are
    there and none is given.
    """
    began, said = time.monotonic(), False
    while not stop():
        time.sleep(POLL)
        offered = node.offered()
        if given in offered and offered[given][0] != CLOUD:
            raise SequenceError(f"{given} (`topic`) is of {offered[given][0]}, not of {CLOUD}")
        there = sorted(topic for topic, (kind, _) in offered.items() if kind == CLOUD)
        if given is None and len(there) > 1:
            raise SequenceError(f"several topics are of {CLOUD}; name one (`topic`): {some(there, MOST)}")
        if given in there or (given is None and there):
            topic = given or there[0]
            log.info("%s is there, %s", topic, "reliable" if offered[topic][1] else "best effort")
            return topic
        if not said and time.monotonic() - began > QUIET:
            others = some([f"{topic} ({kind})" for topic, (kind, _) in sorted(offered.items())], MOST)
            log.info("nobody publishes %s yet (`domain`); there is %s", given or CLOUD, others or "no topic at all")
            said = True
    return None


def take_clouds(node: Node, topic: str) -> Newest[Arrived]:
    """The newest cloud of a topic. It is subscribed to as it is offered: by best effort, of most drivers."""
    newest = Newest[Arrived]()
    quality = Quality(reliable=node.offered()[topic][1], kept=SENSOR.kept)
    node.subscribe(topic, CLOUD, quality, lambda data: newest.put(Arrived(data, time.time())))
    return newest


def take_poses(node: Node, topic: str | None, feed: PoseFeed) -> None:
    """Transforms, and the odometry of a topic. Raises SequenceError where that is of another type.

    A message that cannot be read counts as none, which is said once a topic: anybody may publish there.
    """
    for name in ("/tf", f"/{STATIC}"):
        static = name.endswith(STATIC)
        node.subscribe(
            name, TF[0], Quality(latched=static), careful(name, taker_of_transforms(node, name, static, feed))
        )
    if topic is not None:
        kind = node.offered().get(topic, (ODOMETRY, True))[0]
        if kind != ODOMETRY:
            raise SequenceError(f"{topic} (`pose_topic`) is of {kind}, not of {ODOMETRY}")
        odometry = Quality(reliable=False)  # also takes what is reliable
        node.subscribe(topic, ODOMETRY, odometry, careful(topic, taker_of_odometry(node, topic, feed)))


def careful(topic: str, take: Callable[[bytes], object]) -> Callable[[bytes], None]:
    """`take`, but for what it refuses."""
    said = False

    def taken(data: bytes) -> None:
        nonlocal said
        try:
            take(data)
        except MosError as error:
            if not said:
                log.warning("a message is left out, the first of %s: %s", topic, error)
            said = True

    return taken


def taker_of_odometry(node: Node, topic: str, feed: PoseFeed) -> Callable[[bytes], None]:
    """Takes the messages of a topic, for the feed. It raises ScanError."""
    return lambda data: feed.add_odometry(node.decoded(data, ODOMETRY, topic))


def taker_of_transforms(node: Node, name: str, static: bool, feed: PoseFeed) -> Callable[[bytes], None]:
    """The same of TF. static: they hold for ever."""
    return lambda data: feed.add_transforms(node.decoded(data, TF[0], name), static)

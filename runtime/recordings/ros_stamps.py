"""When the clouds of a bag were taken, and where they lie in it."""

import logging
import warnings
from dataclasses import dataclass

import numpy as np

from runtime.errors import MosWarning, ScanError, SequenceError, some
from runtime.recordings.bag import Bag
from runtime.recordings.pointcloud2 import Head
from runtime.recordings.pose_files import Times
from runtime.recordings.ros_topics import CLOUD

PART = 0.1  # of a bag, and at least LONG s, without a cloud at its beginning or end
LONG = 2.0

log = logging.getLogger("lidar_mos.recordings")


@dataclass(frozen=True)
class Stamps:
    """Of every cloud of a topic, in the order of the bag."""

    received: tuple[int, ...]  # ns, when it came into the bag
    times: Times  # (T,) s, when it was taken, by its header; if the headers have none, when it came into the bag
    counts: tuple[int, ...]  # points
    frame: str  # in which the points are, of the first cloud

    def place(self, index: int) -> tuple[int, int]:
        """Where cloud number `index` begins: time in ns, and how many of the same time are before it."""
        time = self.received[index]
        return time, index - self.received.index(time)

    @classmethod
    def of(cls, bag: Bag, topic: str, limit: int | None) -> "Stamps":
        """Of the first `limit` clouds. Raises SequenceError where there are none; warns of stamps of no use."""
        received, heads = list[int](), list[Head]()
        try:
            for message in bag.messages(topic):
                if len(heads) == limit:
                    break
                heads.append(Head.of(message.data, bag.ros1))
                received.append(message.received)
        except (ScanError, ValueError, IndexError) as error:
            warnings.warn(
                f"{bag.path}: after {len(heads)} scans it cannot be read any more ({error}): only these are there",
                MosWarning,
                stacklevel=2,
            )
        if not heads:
            raise SequenceError(f"{bag.path}: holds no readable message of {topic}")
        if len(frames := sorted({head.frame for head in heads})) > 1:
            raise SequenceError(
                f"{bag.path}: {topic} holds clouds of several frames, {some(frames)}: of several LiDARs"
            )
        if len(heads) != limit:
            _warn_of_missing(bag, topic, received)
        times = np.array([head.stamp for head in heads])
        if (len(times) > 1 and not np.any(np.diff(times))) or not times.any():
            log.info("%s: the stamps of %s are all %g: the times of recording are used", bag.path, topic, times[0])
            times = 1e-9 * np.array(received, np.float64)
        elif (back := np.flatnonzero(np.diff(times) < 0)).size:
            warnings.warn(
                f"{bag.path}: the stamps of {topic} jump back after scan {back[0]}"
                + (f" and {len(back) - 1} more" if len(back) > 1 else ""),
                MosWarning,
                stacklevel=2,
            )
        return cls(tuple(received), times, tuple(head.count for head in heads), heads[0].frame)


def _warn_of_missing(bag: Bag, topic: str, received: list[int]) -> None:
    """MosWarning where the clouds begin long after the bag, or end long before it."""
    if (span := bag.span()) is None:
        return
    begin, end = span
    late, early = 1e-9 * received[0] - begin, end - 1e-9 * received[-1]
    if max(late, early) > max(LONG, PART * (end - begin)):
        where = f"begin {late:.1f} s after the bag does" if late > early else f"end {early:.1f} s before the bag does"
        others = [one for one, (kind, count) in bag.topics().items() if kind == CLOUD and count and one != topic]
        named = f"; there is also {some(others)}" if others else ""
        warnings.warn(f"{bag.path}: the clouds of {topic} {where}{named}", MosWarning, stacklevel=2)

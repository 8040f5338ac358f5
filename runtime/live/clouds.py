"""From the messages of a topic to scans."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from runtime.errors import ScanError
from runtime.live.dds import Node
from runtime.recordings.cloud import Cloud
from runtime.recordings.point_times import PointTimes
from runtime.recordings.pointcloud2 import to_cloud
from runtime.recordings.recording import Scan
from runtime.recordings.remission import Remission
from runtime.recordings.ros_topics import CLOUD, warn_of_changed


@dataclass(frozen=True)
class Arrived:
    """A message as it came."""

    data: bytes
    time: float  # s since 1970, when it came


class Clouds:
    """Reads the clouds of one topic, which are those of one LiDAR, as those of a bag are read."""

    def __init__(self, node: Node, topic: str, remission_scale: float | None) -> None:
        """remission_scale: see `Options`; None: as the first cloud shows."""
        self._node, self.topic, self.frame = node, topic, ""
        self._remission = Remission(remission_scale, topic, self._first)
        self._point_times = PointTimes(topic, self._first)
        self._seen: Cloud  # the last one

    def read(self, arrived: Arrived, key: str) -> tuple[Any, Scan]:
        """A PointCloud2 and the scan that it holds, without a pose. Raises ScanError."""
        where = f"{self.topic}: scan {key}"
        message = self._node.decoded(arrived.data, CLOUD, where)
        frame = message.header.frame_id
        if not self.frame:
            warn_of_changed(self.topic, self.topic, frame)
        elif frame != self.frame:
            raise ScanError(f"{where}: its points are in {frame}, those before in {self.frame}: of another LiDAR?")
        self._seen = cloud = to_cloud(message, where)
        self.frame = frame
        stamp = message.header.stamp
        time = stamp.sec + 1e-9 * stamp.nanosec or arrived.time
        times = self._point_times.seconds(cloud.times, time)
        return message, Scan(key, self._remission.scaled(cloud.data), None, time, cloud.ring, times)

    def _first(self) -> Iterator[Cloud]:
        yield self._seen

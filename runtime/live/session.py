"""Clouds of a running system in, labelled ones out: the newest only, so that it never lags."""

import time
import warnings
from collections.abc import Callable
from pathlib import Path

from runtime.errors import MosWarning, NoPosesError, PoseError, ScanError
from runtime.live.clouds import Arrived, Clouds
from runtime.live.dds import CLOUDS, Node
from runtime.live.joining import POLL, QUIET, find_topic, take_clouds, take_poses
from runtime.live.live_summary import LiveSummary
from runtime.live.placing import Placing
from runtime.live.pose_feed import PoseFeed
from runtime.recordings.pointcloud2_edits import with_labels, without
from runtime.recordings.recording import Options
from runtime.recordings.ros_topics import CLOUD
from runtime.runner import MosRunner

TOPICS = ("labelled", "static")  # below that of the clouds
OFTEN = 30.0  # s between reports
BUFFER = Path("/proc/sys/net/core/rmem_max")  # bytes that a socket may have wait, on Linux
SYSCTL, ENOUGH = "net.core.rmem_max", 1 << 25


class Session:
    """Labels the clouds of one topic until it is told to stop."""

    def __init__(self, node: Node, runner: MosRunner, options: Options) -> None:
        """options: `topic`, None: the only one; `pose_topic` of odometry, None: TF, in which `world` is; `extrinsics`;
        `remission_scale`; `given_poses`: needed, or, where none come, found by the runner's odometry, or always found.

        Raises SettingError.
        """
        self._node, self._runner, self._options = node, runner, options
        self._feed = PoseFeed(options) if options.reads_poses else None
        self._placing = Placing(self._feed, options.given_poses == "needed")
        self._said = set[str]()
        self.summary = LiveSummary()

    def run(
        self, stop: Callable[[], bool], on_report: Callable[[LiveSummary], object] = lambda summary: None
    ) -> LiveSummary:
        """Join the system, and label until `stop()`. on_report: is called every 30 s.

        A cloud that is none, or has no pose, is left out and counted, the first with a MosWarning. Raises SequenceError
        where a topic is of another type, NoPosesError where none come and they are needed, InferenceError, OutputError.
        """
        # Join
        topic = find_topic(self._node, self._options.topic, stop)
        if topic is None:
            return self.summary
        newest = take_clouds(self._node, topic)
        if self._feed is not None:
            take_poses(self._node, self._options.pose_topic, self._feed)
        clouds = Clouds(self._node, topic, self._options.remission_scale)
        publish = {name: self._node.publisher(f"{topic}/{name}", CLOUD, CLOUDS) for name in TOPICS}
        self._node.start()
        # Label
        heard = reported = time.monotonic()
        while not stop():
            self._node.check()
            arrived, now = newest.take(POLL), time.monotonic()
            if arrived is not None:
                first, heard = not self.summary.scans, now
                self._label(clouds, arrived, newest.came - 1, publish)
                if first and self.summary.scans:
                    self.summary.before = newest.restart()
                self.summary.dropped = newest.dropped
            elif now - heard > QUIET:
                self._warn("quiet", f"no cloud came on {topic} for {QUIET:g} s. {_advice()}")
            self.summary.lost = self._node.lost(topic)
            if self.summary.lost:
                self._warn("lost", f"clouds of {topic} get lost on the way. {_advice()}")
            if now - reported > OFTEN:
                on_report(self.summary)
                reported = now
        return self.summary

    def _label(
        self, clouds: Clouds, arrived: Arrived, number: int, publish: dict[str, Callable[[bytes], bool]]
    ) -> None:
        """Read, place, label and publish a cloud, or count why not."""
        try:
            message, scan = clouds.read(arrived, f"{number:06d}")
            assert scan.time is not None
            pose = self._placing.pose(clouds.frame, scan.time)
            result = self._runner(scan, pose)
            labelled = with_labels(message, result.moving, result.probability, clouds.topic)
        except NoPosesError:
            raise
        except PoseError as error:
            if self.summary.scans:  # else they are waited for
                self.summary.unposed += 1
                self._warn("pose", f"a scan without a pose is left out: {error}")
            return
        except ScanError as error:
            self.summary.broken += 1
            self._warn("scan", f"a cloud is left out: {error}")
            return
        for name, cloud in zip(TOPICS, (labelled, without(message, ~result.moving)), strict=True):
            self.summary.slow += not publish[name](self._node.encoded(cloud, CLOUD))
        self.summary.scans += 1
        now = time.time()
        self.summary.from_stamp.append(now - scan.time)
        self.summary.from_arrival.append(now - arrived.time)

    def _warn(self, what: str, text: str) -> None:
        """Once of each kind: messages name scans, and there are ten a second."""
        if what not in self._said:
            self._said.add(what)
            warnings.warn(text, MosWarning, stacklevel=3)


def _advice() -> str:
    """Why large messages do not come through."""
    if BUFFER.is_file() and (room := int(BUFFER.read_text())) < ENOUGH:
        return f"Large ones need room in the system's buffers, which is {room:,} bytes: sysctl -w {SYSCTL}={ENOUGH}"
    return "Is its publisher running, and the network quick enough?"

"""`mos live` at the pace of a LiDAR: `python -m bench.live --seconds 60`.

Another process publishes a drive, forwards and backwards, with its poses by TF, over DDS on this machine. Counted is
what was dropped or lost; timed, from the stamp of a scan, taken before it is published, to the publication of its
labels; memory, from a third of the time on, when all is laid out.
"""

import multiprocessing
import sys
import threading
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy.spatial.transform import Rotation

from bench.report import resident_mb, save, show
from bench.scans import load_frames, there_and_back
from runtime import MosRunner
from runtime.commands.handler import run_alone
from runtime.live.dds import CLOUDS, SENSOR, Node, Quality
from runtime.live.session import Session
from runtime.recordings.bag import TF
from runtime.recordings.recording import Options
from runtime.recordings.ros_topics import CLOUD

TOPIC = "/points"
SCANS = 60  # of the drive
STEP = 32  # bytes of a point, as drivers pad them


class Publisher:
    """Messages of a driver and of an odometry."""

    def __init__(self, node: Node, reliable: bool) -> None:
        self._node, self._make = node, node.types.types
        self._cloud = node.publisher(TOPIC, CLOUD, CLOUDS if reliable else SENSOR)
        self._tf = node.publisher("/tf", TF[0], Quality())

    def publish(self, scan: np.ndarray, pose: np.ndarray, stamp: float) -> None:
        """A scan (N, 4) and T_odom_lidar at a time in s."""
        make, nanoseconds = self._make, int(1e9 * stamp)
        time_ = make["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
        place = make["geometry_msgs/msg/Vector3"](*map(float, pose[:3, 3]))
        turn = make["geometry_msgs/msg/Quaternion"](*map(float, Rotation.from_matrix(pose[:3, :3]).as_quat()))
        transform = make["geometry_msgs/msg/Transform"](place, turn)
        header = make["std_msgs/msg/Header"]
        stamped = make["geometry_msgs/msg/TransformStamped"](header(time_, "odom"), "lidar", transform)
        self._tf(self._node.encoded(make[TF[0]]([stamped]), TF[0]))
        data = np.zeros((len(scan), STEP), np.uint8)
        data[:, : 4 * scan.shape[1]] = np.ascontiguousarray(scan, "<f4").view(np.uint8).reshape(len(scan), -1)
        names = ("x", "y", "z", "intensity")
        fields = [make["sensor_msgs/msg/PointField"](name, 4 * index, 7, 1) for index, name in enumerate(names)]
        size = (1, len(scan), fields, False, STEP, STEP * len(scan), data.reshape(-1), False)
        self._cloud(self._node.encoded(make[CLOUD](header(time_, "lidar"), *size), CLOUD))


def drive(sequence: Path | None, domain: int, rate: float, reliable: bool, ready: Any, done: Any) -> None:
    """Publish until `done`. ready: is told when it begins."""
    frames = there_and_back(load_frames(sequence, SCANS))
    with Node(domain) as node:
        publisher = Publisher(node, reliable)
        ready.set()
        next_, index = time.time(), 0
        while not done.is_set():
            publisher.publish(*frames[index % len(frames)], time.time())
            index, next_ = index + 1, next_ + 1 / rate
            time.sleep(max(0.0, next_ - time.time()))


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    seconds: Annotated[float, typer.Option(help="After the first labels")] = 60.0,
    rate: Annotated[float, typer.Option(help="Scans a second")] = 10.0,
    odometry: Annotated[bool, typer.Option("--odometry", help="Poses by KISS-ICP, not by TF")] = False,
    reliable: Annotated[bool, typer.Option("--reliable", help="Clouds are published reliably")] = False,
    threads: int = 2,
    domain: Annotated[int, typer.Option(help="Of DDS, which nobody else is in")] = 91,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Dropped scans, latency and growth of memory beside a publisher in another process."""
    context = multiprocessing.get_context("spawn")
    ready, done = context.Event(), context.Event()
    process = context.Process(target=drive, args=(sequence, domain, rate, reliable, ready, done), daemon=True)
    process.start()
    ready.wait()
    options = Options(topic=TOPIC, given_poses="ignored" if odometry else "needed")
    with Node(domain) as node, MosRunner(bundle, threads=threads, odometry="kiss" if odometry else None) as runner:
        session = Session(node, runner, options)
        memory: list[float] = []
        ended = threading.Event()

        def watch() -> None:
            while not session.summary.scans:
                time.sleep(0.1)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                memory.append(resident_mb())
                time.sleep(1.0)
            ended.set()

        threading.Thread(target=watch, daemon=True).start()
        found = session.run(ended.is_set)
    done.set()
    process.join()
    p50, p95 = found.latency()
    grown = memory[-1] - memory[len(memory) // 3]
    counts = {"scans": found.scans, "dropped": found.dropped, "lost": found.lost, "unposed": found.unposed}
    latency = {"stamp to labels, ms": 1e3 * p50, "p95": 1e3 * p95}
    row = {**counts, **latency, "memory, MB": memory[-1], "grown, MB": grown}
    show(f"{rate:g} Hz for {seconds:g} s, {threads} threads", {runner.bundle.manifest.name: row})
    kind = {"odometry": "kiss" if odometry else "tf", "reliable": reliable, "rate": rate, "seconds": seconds}
    save(out, threads, {"bundle": runner.bundle.manifest.name, **kind, "live": row})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "live"))

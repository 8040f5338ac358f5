"""Whole recordings, runners and runs that `bench.faults` damages, as `bench.damaged` does single files."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bench.damaged import BUNDLE, SCAN, SEQUENCE, Target, of_file


@contextmanager
def copied() -> Iterator[Path]:
    """The tiny sequence."""
    with tempfile.TemporaryDirectory() as temporary:
        yield Path(shutil.copytree(SEQUENCE, Path(temporary) / "sequences" / "00"))


def recording(name: str) -> Iterator[Target]:
    """A file of a KITTI sequence, all of which is read."""
    from runtime.recordings.recording import Options
    from runtime.recordings.registry import open_recording

    def read(_: Path) -> None:
        for skip in (False, True):
            for index, one in enumerate((found := open_recording(folder, Options(skip_broken=skip))).scans()):
                found.fingerprint(one)
                found.labels(index)

    with copied() as folder:
        yield Target(folder / name, (folder / name).read_bytes(), read)


def bag(kind: str) -> Iterator[Target]:
    """A bag with clouds and odometry."""
    from runtime.recordings.registry import open_recording
    from tests.support.bag_writers import BagWriter, single_file

    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / ("a.bag" if kind == "bag" else "a")
        with BagWriter(path, kind) as writer:
            for index in range(4):
                pose = np.eye(4)
                pose[0, 3] = index / 2
                writer.pose(pose, index / 10)
                writer.cloud(SCAN, index / 10)
        file = single_file(path)
        yield Target(file, file.read_bytes(), lambda _: list(open_recording(path).scans()))


def packets() -> Iterator[Target]:
    """A capture of a Velodyne's packets."""
    from runtime.recordings.recording import Options
    from runtime.recordings.registry import open_recording
    from tests.support.packets import write_vlp16

    options = Options(points_only=True)
    with tempfile.TemporaryDirectory() as folder:
        path = write_vlp16(Path(folder) / "a.pcap")
        yield Target(path, path.read_bytes(), lambda _: list(open_recording(path, options).scans()))


def runner() -> Iterator[Target]:
    """A scan that a runner labels, which afterwards is as before."""
    from runtime import MosRunner
    from runtime.recordings.formats.registry import read_cloud
    from runtime.recordings.registry import open_recording

    frames = [(one.data, one.known_pose()) for one in open_recording(SEQUENCE).scans()][:3]
    with MosRunner(BUNDLE, threads=1, belief="online") as labelling:
        for frame in frames[:-1]:
            labelling(*frame)
        want = labelling(*frames[-1]).probability

        def read(path: Path) -> None:
            labelling.reset()
            try:
                labelling(read_cloud(path).data, frames[0][1])
            finally:
                labelling.reset()
                got = [labelling(*frame).probability for frame in frames][-1]
                if not np.array_equal(got, want):
                    raise AssertionError("the runner is not as it was")

        yield from of_file("000000.bin", (SEQUENCE / "velodyne" / "000000.bin").read_bytes(), read)


def live(topic: str) -> Iterator[Target]:
    """A message of a running system; what comes after it is placed."""
    from runtime.live.clouds import Arrived, Clouds
    from runtime.live.dds import Node
    from runtime.live.joining import taker_of_odometry, taker_of_transforms
    from runtime.live.pose_feed import PoseFeed
    from runtime.recordings.pointcloud2_edits import with_labels, without
    from runtime.recordings.recording import Options
    from runtime.recordings.ros_topics import CLOUD
    from tests.support.bag_writers import START, BagWriter, messages

    with tempfile.TemporaryDirectory() as temporary, Node() as node:
        with BagWriter(Path(temporary) / "log", "db3") as writer:
            writer.cloud(SCAN, 0.0, topic="/points")
            writer.pose(np.eye(4), 0.0)
            writer.transform(np.eye(4), 0.0, "odom", "lidar")
        whole = {name: found[0][1] for (name, *_), found in messages(Path(temporary) / "log").items()}

        def read(path: Path) -> None:
            feeds = [PoseFeed(Options(pose_topic=one), patience=0.0) for one in (None, "/odom")]
            given = whole | {topic: path.read_bytes()}
            try:
                taker_of_transforms(node, "/tf", topic == "/tf", feeds[0])(given["/tf"])
                taker_of_odometry(node, "/odom", feeds[1])(given["/odom"])
                message, scan = Clouds(node, "/points", None).read(Arrived(given["/points"], START), "000000")
                part = np.arange(len(scan.data)) % 2 == 0
                for cloud in (with_labels(message, part, scan.data[:, 0]), without(message, part)):
                    node.encoded(cloud, CLOUD)
            finally:
                taker_of_transforms(node, "/tf", False, feeds[0])(whole["/tf"])
                taker_of_odometry(node, "/odom", feeds[1])(whole["/odom"])
                for feed in feeds:
                    feed.missing("lidar")
                    feed.pose("lidar", START)

        yield from of_file("message", whole[topic], read)


def run(name: str) -> Iterator[Target]:
    """What `mos run` reads, of which labels are made; or has written, and goes on from. Labels are whole or absent."""
    from runtime import MosRunner
    from runtime.predict import predict
    from runtime.recordings.recording import Options
    from runtime.recordings.registry import open_recording

    options = Options(limit=3, skip_broken=True)
    with copied() as folder, MosRunner(BUNDLE, threads=1, postprocess="none") as labelling:
        out = folder.parents[1] / "out"
        predict(open_recording(folder, options), labelling, out)
        whole = {
            path.relative_to(folder.parents[1]): path.read_bytes()
            for path in folder.parents[1].rglob("*")
            if path.is_file()
        }
        sizes = {
            path.name: len(data) for path, data in whole.items() if path.suffix == ".label" and "out" in path.parts
        }

        def read(path: Path) -> None:
            for place, data in whole.items():  # but for what is damaged, as it was
                if (other := folder.parents[1] / place) != path:
                    other.parent.mkdir(parents=True, exist_ok=True)
                    other.write_bytes(data)
            try:
                predict(open_recording(folder, options), labelling, out, skip_broken=True)
            finally:
                for label in out.rglob("*"):
                    if label.name.endswith(".part"):
                        raise AssertionError(f"{label.name} is left")
                    if (
                        path.parent.name != "velodyne"
                        and sizes.get(label.name, label.stat().st_size) != label.stat().st_size
                    ):
                        raise AssertionError(f"{label.name} is not whole")

        target = folder.parents[1] / name
        yield Target(target, target.read_bytes(), read)

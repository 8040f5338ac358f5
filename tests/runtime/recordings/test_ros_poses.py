"""Poses of the scans of a bag: from its own topics, or from a file."""

import logging
import sqlite3
from contextlib import closing

import numpy as np
import pytest

from runtime.errors import MosWarning, PoseError, SequenceError
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support import street
from tests.support.bag_writers import KINDS, START, BagWriter, single_file

pytest.importorskip("rosbags")
COUNT = 5


@pytest.fixture(scope="module")
def scans():
    drive, world = street.drive(COUNT), street.boxes()
    return [street.scan(pose, world, rows=16, columns=90) for pose in drive]


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def path(tmp_path, kind):
    return tmp_path / ("log.bag" if kind == "bag" else "log")


@pytest.fixture
def drive(path, kind, scans):
    """Odometry three times a scan, of the frame of the points."""
    poses = street.drive(COUNT)
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index)
            for part in range(3):
                bag.pose(poses[index], 0.1 * index + 0.02 * (part - 1))
    return path


def test_odometry_of_the_points_frame_is_found(drive, caplog):
    caplog.set_level(logging.INFO, "lidar_mos")
    recording = open_recording(drive)
    assert recording.poses_from == "/odom"
    assert "the poses are those of /odom" in caplog.text
    np.testing.assert_allclose(recording.poses, street.drive(COUNT), atol=1e-9)
    np.testing.assert_allclose(recording.times, START + 0.1 * np.arange(COUNT), atol=1e-6)
    assert recording.read(2).time == recording.times[2]
    np.testing.assert_array_equal(recording.read(2).pose, recording.poses[2])
    assert set(recording.other_poses()) == {"inverse"}


@pytest.mark.parametrize("child", ["base_link", None])
def test_poses_of_another_frame_are_said(path, kind, scans, child):
    with BagWriter(path, kind) as bag:
        bag.cloud(scans[0], 0.0)
        bag.pose(np.eye(4), 0.0, child=child)
    with pytest.raises(PoseError, match=r"no poses.*\(`pose_topic`\), or .*; there are /odom"):
        open_recording(path)
    with pytest.warns(MosWarning, match="taken as if both were the same"):
        recording = open_recording(path, Options(pose_topic="/odom"))
    np.testing.assert_array_equal(recording.poses[0], np.eye(4))
    with pytest.raises(SequenceError, match="has no poses on /tf"):
        open_recording(path, Options(pose_topic="/tf"))


def test_messages_that_are_counted_and_not_there(tmp_path, scans):
    with BagWriter(tmp_path / "log", "db3") as bag:
        bag.cloud(scans[0], 0.0)
        bag.pose(np.eye(4), 0.0)
    with closing(sqlite3.connect(single_file(tmp_path / "log"))) as base:
        base.execute("DELETE FROM messages WHERE topic_id = (SELECT id FROM topics WHERE name = '/odom')")
        base.commit()
    for topic in (None, "/odom"):
        with pytest.raises(PoseError, match="counts messages of /odom, but holds none"):
            open_recording(tmp_path / "log", Options(pose_topic=topic))


def test_poses_that_end_early(path, kind, scans):
    """A step of the poses goes on as the last one did, which is said; the scan after it has none."""
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index)
        for index in range(3):
            bag.pose(np.eye(4), 0.1 * index)
    with (
        pytest.warns(MosWarning, match="goes on as it is for scan 3"),
        pytest.raises(PoseError, match="has no pose at"),
    ):
        open_recording(path)
    with pytest.warns(MosWarning, match="goes on as it is for scan 3"):
        recording = open_recording(path, Options(skip_broken=True))
    assert recording.read(3).pose is not None
    with pytest.raises(PoseError, match="has no pose at"):
        recording.read(4)


def test_poses_of_a_file_by_line_and_by_time(drive, tmp_path):
    poses = street.drive(COUNT)
    street.write_poses(tmp_path / "kitti.txt", poses)
    np.testing.assert_allclose(open_recording(drive, Options(poses=tmp_path / "kitti.txt")).poses, poses, atol=1e-8)
    rows = [f"{START + 0.05 * i:.2f} {i} 0 0 0 0 0 1\n" for i in range(2 * COUNT)]
    (tmp_path / "tum.txt").write_text("".join(rows))
    recording = open_recording(drive, Options(poses=tmp_path / "tum.txt"))
    np.testing.assert_allclose(recording.poses[:, 0, 3], 2 * np.arange(COUNT), atol=1e-4)
    assert recording.poses_from.endswith("tum.txt, lidar")

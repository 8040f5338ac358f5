"""Both versions of rosbags read bare files and folders; ouster-sdk holds to the old one."""

import sqlite3

import numpy as np
import pytest

from runtime.recordings.old_rosbags import NOTE, as_folder, is_old
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support.bag_writers import BagWriter, single_file
from tests.support.paths import DATA

pytest.importorskip("rosbags")
LOG = DATA / "mcap"  # of 3 scans of 40 points, `np.random.default_rng(number).random((40, 4))`; its note has version 9


@pytest.mark.parametrize("path", [LOG, LOG / "mcap.mcap"])
def test_mcap(path):
    recording = open_recording(path)
    assert recording.poses_from == "/odom"
    for index, scan in enumerate(recording):
        np.testing.assert_array_equal(scan.data, np.random.default_rng(index).random((40, 4)).astype(np.float32))
    assert len(recording) == 3
    np.testing.assert_array_equal(recording.read(1).data[0], recording.scans(1).__next__().data[0])


def test_the_note_of_a_bare_database(tmp_path):
    with BagWriter(tmp_path / "log", "db3") as bag:
        bag.cloud(np.ones((5, 4), np.float32), 0.0)
        bag.cloud(np.ones((5, 4), np.float32), 0.1)
        bag.pose(np.eye(4), 0.0, child=None)
    file = single_file(tmp_path / "log")
    (tmp_path / "links").mkdir()
    folder = as_folder(file, tmp_path / "links")
    assert (folder / file.name).resolve() == file.resolve()
    text = (folder / NOTE).read_text()
    assert '{"message_count": 2, "topic_metadata": {"name": "/points", "type": "sensor_msgs/msg/PointCloud2"' in text
    assert '{"message_count": 1, "topic_metadata": {"name": "/odom"' in text
    assert len(open_recording(file, Options(points_only=True))) == 2
    file.write_bytes(b"SQLite format 3\0" + bytes(200))
    (tmp_path / "others").mkdir()
    with pytest.raises(sqlite3.DatabaseError):
        as_folder(file, tmp_path / "others")


def test_a_folder_that_the_old_one_reads_is_itself(tmp_path):
    """Only where that is installed can it be written."""
    if not is_old():
        pytest.skip("rosbags is newer")
    with BagWriter(tmp_path / "log", "db3") as bag:
        bag.cloud(np.ones((5, 4), np.float32), 0.0)
    assert as_folder(tmp_path / "log", tmp_path) == tmp_path / "log"

"""Copies of bags without some points: everything else is byte for byte the same."""

import numpy as np
import pytest

from runtime.errors import CutShortError, SettingError
from runtime.files import replacing_folder, sweep
from runtime.recordings.old_rosbags import is_old
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support.bag_writers import KINDS, BagWriter, messages, single_file
from tests.support.disk import small_disk

pytest.importorskip("rosbags")

RINGS = np.dtype([("ring", "<u2"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4")])


@pytest.fixture(params=KINDS)
def bag(request, tmp_path):
    """A bag of clouds, some organised, with other topics, and one that is empty."""
    scans = [np.random.default_rng(i).uniform(-9, 9, (60, 4)).astype(np.float32) for i in range(4)]
    path = tmp_path / ("log.bag" if request.param == "bag" else "log")
    with BagWriter(path, request.param) as writer:
        for i, scan in enumerate(scans):
            writer.pose(np.eye(4), i / 10)
            shape = (6, 10) if i == 1 else None
            writer.cloud(scan, i / 10, dtype=RINGS, shape=shape, padding=7 if i == 1 else 0)
            writer.cloud(scan[:5], i / 10, topic="/rear")
    return path


def test_all_but_the_points_is_as_it_was(bag, tmp_path):
    options = Options(topic="/points", points_only=True)
    recording = open_recording(bag, options)
    keeps = [np.arange(60) % (i + 2) != 0 for i in range(4)]
    recording.write_kept(tmp_path / "clean", iter((i, keeps[i]) for i in (0, 1, 3)))
    (copy,) = (tmp_path / "clean").iterdir()
    assert copy.name == bag.name
    before, after = messages(bag), messages(copy)
    assert before.keys() == after.keys()
    for key in before:
        if key[0] != "/points":
            assert after[key] == before[key]
        else:
            assert [time for time, _ in after[key]] == [time for i, (time, _) in enumerate(before[key]) if i != 2]
    kept = list(open_recording(copy, options))
    for scan, i in zip(kept, (0, 1, 3), strict=True):  # the third was broken
        one = recording.read(i)
        np.testing.assert_array_equal(scan.data, one.data[keeps[i]])
        np.testing.assert_array_equal(scan.ring, one.ring[keeps[i]])


def test_a_single_file_of_ros_2_becomes_a_folder(bag, tmp_path):
    file = single_file(bag)
    options = Options(topic="/points", points_only=True)
    if is_old() and bag.is_dir():
        with pytest.raises(SettingError, match="copies neither MCAP nor single files"):
            open_recording(file, options).write_kept(tmp_path / "clean", iter([]))
        return
    open_recording(file, options).write_kept(tmp_path / "clean", iter([(0, np.zeros(60, bool))]))
    (copy,) = (tmp_path / "clean").iterdir()
    assert [len(scan.data) for scan in open_recording(copy, options)] == [0]


@pytest.mark.parametrize("kind", KINDS)
def test_where_the_disk_is_full_the_copy_ends_with_a_whole_message(tmp_path, kind):
    """It is never moved into place, keeps its temporary name, and can be read until there."""
    scan = np.random.default_rng(1).uniform(-9, 9, (60_000, 4)).astype(np.float32)
    path = tmp_path / ("log.bag" if kind == "bag" else "log")
    with BagWriter(path, kind) as writer:
        for index in range(40):
            writer.cloud(scan, index / 10)
            writer.pose(np.eye(4), index / 10)
    recording = open_recording(path, Options(topic="/points", points_only=True))
    every = ((index, np.ones(len(scan), bool)) for index in range(len(recording)))
    with small_disk(tmp_path / "disk", 32 << 20) as disk:
        with (
            pytest.raises(CutShortError, match=r"full after [0-9]+ messages") as said,
            replacing_folder(disk / "copy") as new,
        ):
            recording.write_kept(new, every)
        (left,) = disk.iterdir()
        assert left.name.startswith(".copy.")
        (copy,) = left.iterdir()
        assert str(copy) in str(said.value)
        before, after = messages(path), messages(copy)
        assert before.keys() == after.keys()
        assert 0 < sum(map(len, after.values())) < 80
        for key, some in after.items():
            assert some == before[key][: len(some)]
        sweep(disk)
        assert not list(disk.iterdir())

"""From labels to a map and a recording without movers."""

from dataclasses import replace

import numpy as np
import pytest

from runtime.belief.result import MosResult
from runtime.cleaning.cleaning import FORMATS, write_clean, write_maps
from runtime.cleaning.labelled_clouds import LabelledClouds
from runtime.cleaning.votes import RecordingVotes
from runtime.errors import SequenceError, SettingError
from runtime.recordings.around import Around
from runtime.recordings.formats.registry import read_cloud
from runtime.recordings.labels import write_labels
from runtime.recordings.registry import open_recording
from tests.support import street

COUNT = 6
BOX = np.float32([[12, 1, -1], [14, 3, 0.5]])  # m, in which something is at first
ASIDE = np.float32([0, -1, 0])  # m, that it goes on from scan to scan
MISSED = 1, 2, 3  # that scan in which it was, and those which see it where it was then


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A street, and a box that crosses it before the LiDAR."""
    folder = street.write_kitti(tmp_path_factory.mktemp("street") / "07", COUNT, rows=32, columns=480)
    rng = np.random.default_rng(0)
    for index, path in enumerate(sorted((folder / "velodyne").iterdir())):
        box = rng.uniform(*(BOX + index * ASIDE), (200, 3)).astype(np.float32)
        scan = np.concatenate([np.fromfile(path, "<f4").reshape(-1, 4), np.column_stack([box, np.ones(200)])])
        scan.astype("<f4").tofile(path)
    return open_recording(folder)


@pytest.fixture(scope="module")
def labels(recording, tmp_path_factory):
    """The box moves; of one scan it was missed, and in another a wall was taken for it."""
    folder = tmp_path_factory.mktemp("labels")
    for index, scan in enumerate(recording):
        moving = np.arange(len(scan.data)) >= len(scan.data) - 200
        if index == 2:
            moving[:] = False
        if index == 3:
            moving[:300] = True
        write_labels(folder / f"{scan.key}.label", moving)
    return folder


@pytest.fixture(scope="module")
def votes(recording, labels):
    return RecordingVotes(recording, labels, 0.5)


def test_what_moves_is_left_out_by_most_votes(recording, votes, tmp_path):
    left = write_clean(votes, tmp_path / "clean")
    assert (left.scans, left.points) == (COUNT, sum(len(scan.data) for scan in recording))
    for index, scan in enumerate(recording):
        kept = np.fromfile(tmp_path / "clean" / "velodyne" / f"{scan.key}.bin", "<f4").reshape(-1, 4)
        ordered = {row.tobytes(): place for place, row in enumerate(scan.data)}
        places = [ordered[row.tobytes()] for row in kept]
        assert places == sorted(places)  # points are as they were, in their order
        box = sum(place >= len(scan.data) - 200 for place in places)
        assert box <= (200 if index in MISSED else 30)  # some of it hides its own place all the time
        assert len(places) - box > 0.95 * (len(scan.data) - 200)
    assert left.kept == sum(len(path.read_bytes()) // 16 for path in (tmp_path / "clean" / "velodyne").iterdir())


def test_the_map_is_in_the_frame_of_the_first_scan(recording, votes, tmp_path):
    ((path, count),) = write_maps(votes, tmp_path).items()
    assert path == tmp_path / "map.ply"
    points = read_cloud(path).data[:, :3]
    assert len(points) == count > 1000
    first = recording.read(0).points[:-200].astype(float)
    apart = np.linalg.norm(first[::50, None] - points[None], axis=2).min(1)
    assert (apart < 0.5).mean() > 0.9
    inside = (points > BOX[0]).all(1) & (points < BOX[1]).all(1)
    assert inside.sum() <= 3
    write_maps(votes, tmp_path, "pcd")
    np.testing.assert_array_equal(read_cloud(tmp_path / "map.pcd").data, read_cloud(path).data)


@pytest.mark.parametrize("form", [form for form in FORMATS if form != "same"])
def test_clouds_in_other_formats(recording, votes, tmp_path, form):
    write_clean(votes, tmp_path / "other", form)
    write_clean(votes, tmp_path / "clean")
    for key in recording.keys:
        got = read_cloud(tmp_path / "other" / f"{key}.{form}").data
        np.testing.assert_array_equal(got, read_cloud(tmp_path / "clean" / "velodyne" / f"{key}.bin").data)


def test_where_an_odometry_was_lost_another_map_begins(recording, labels, tmp_path):
    class Lost(Around):
        def seen(self, index, scan):
            return replace(scan, lost="fog") if index in (0, 4) else scan

    maps = write_maps(RecordingVotes(Lost(recording), labels, 0.5), tmp_path)
    assert [path.name for path in maps] == ["map_000000.ply", "map_000004.ply"]


def test_labels_that_are_missing_are_said(recording, labels, tmp_path):
    with pytest.raises(SequenceError, match=r"000000\.label: labels cannot be read"):
        RecordingVotes(recording, tmp_path)
    with pytest.raises(SettingError, match="`format` must be one of same, ply, pcd, npy, not 'las'"):
        write_clean(RecordingVotes(recording, labels), tmp_path, "las")


def test_what_was_there_stays_where_writing_fails(recording, votes, tmp_path, monkeypatch):
    write_clean(votes, tmp_path / "clean")
    before = sorted(path.read_bytes() for path in (tmp_path / "clean" / "velodyne").iterdir())

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("runtime.recordings.scan_files.kept_points", full)
    with pytest.raises(OSError, match="No space left"):
        write_clean(votes, tmp_path / "clean")
    assert sorted(path.read_bytes() for path in (tmp_path / "clean" / "velodyne").iterdir()) == before
    assert [path.name for path in tmp_path.iterdir()] == ["clean"]


def test_clouds_with_labels(recording, tmp_path):
    scan = recording.read(0)
    count = len(scan.data)
    moving, probability = np.arange(count) % 3 == 0, np.linspace(0, 1, count, dtype=np.float32)
    clouds = LabelledClouds(tmp_path, "pcd")
    clouds.write(scan, MosResult(moving, probability, True, {}, 0, np.eye(4), "hdl64e"))
    head = clouds.path(scan.key).read_bytes()[:400]
    assert b"FIELDS x y z intensity moving probability\nSIZE 4 4 4 4 1 4\nTYPE F F F F U F\n" in head
    np.testing.assert_array_equal(read_cloud(clouds.path(scan.key)).data, scan.data)

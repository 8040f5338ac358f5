import numpy as np
import pytest

from runtime.errors import ScanError, SequenceError
from runtime.recordings.labels import write_labels
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from runtime.recordings.scan_files import list_scans
from tests.support import street

LIDAR = Options(frame="lidar")


def plain(folder, count, poses, name="{:d}.npy"):
    folder.mkdir()
    for i in range(count):
        np.save(folder / name.format(i), np.full((i + 1, 3), i, np.float32))
    street.write_poses(folder / "poses.txt", poses)
    return folder


def test_kitti_layout(folder):
    recording = open_recording(folder)
    assert (recording.name, recording.source, recording.sensor) == ("03", str(folder), None)
    assert recording.keys == tuple(f"{i:06d}" for i in range(6))
    assert len(recording) == 6
    assert recording.times is None
    drive = street.drive(6)
    np.testing.assert_allclose(recording.poses, np.linalg.inv(drive[0]) @ drive, atol=1e-6)
    scan = recording.read(2)
    expected = street.scan(drive[2], street.boxes(), rows=4, columns=20)
    assert (scan.key, scan.time) == ("000002", None)
    np.testing.assert_array_equal(scan.data, expected)
    np.testing.assert_array_equal(scan.points, expected[:, :3])
    np.testing.assert_array_equal(scan.remission, expected[:, 3])
    np.testing.assert_array_equal(scan.pose, recording.poses[2])
    assert recording.count(2) == len(expected)


def test_points_and_remission_are_views(folder):
    scan = open_recording(folder).read(0)
    assert scan.data.dtype == np.float32
    assert scan.data.flags.c_contiguous
    assert np.shares_memory(scan.points, scan.data)
    assert np.shares_memory(scan.remission, scan.data)


def test_scans_in_order_from_anywhere(folder):
    recording = open_recording(folder)
    assert [scan.key for scan in recording] == list(recording.keys)
    assert [scan.key for scan in recording.scans(4)] == ["000004", "000005"]
    assert [scan.key for scan in open_recording(folder, Options(limit=2))] == ["000000", "000001"]


def test_plain_folder_in_natural_order_with_lidar_poses(tmp_path):
    poses = street.drive(12)
    recording = open_recording(plain(tmp_path / "log", 12, poses), LIDAR)
    assert recording.keys == tuple(str(i) for i in range(12))
    np.testing.assert_allclose(recording.poses, poses, atol=1e-8)
    scan = recording.read(10)
    assert scan.data.shape == (11, 3)
    assert scan.remission is None


def test_without_poses(folder):
    (folder / "poses.txt").unlink()
    recording = open_recording(folder, Options(points_only=True))
    assert recording.poses is None
    assert recording.read(0).pose is None


def test_labels(folder):
    recording = open_recording(folder)
    count = recording.count(3)
    write_labels(folder / "labels" / "000003.label", np.arange(count) % 2 == 0)
    assert recording.labels(2) is None
    np.testing.assert_array_equal(recording.labels(3), np.where(np.arange(count) % 2 == 0, 251, 9))
    write_labels(folder / "labels" / "000003.label", np.zeros(count + 1, bool))
    with pytest.raises(SequenceError, match=f"labels of {count} points"):
        recording.labels(3)


def test_times_as_names_are_in_order_of_time(tmp_path):
    (tmp_path / "log").mkdir()
    for name in ("9.5", "10.45", "10.5", "10.405"):
        (tmp_path / "log" / f"{name}.bin").touch()
    assert [scan.stem for scan in list_scans(tmp_path / "log")] == ["9.5", "10.405", "10.45", "10.5"]


@pytest.mark.parametrize("names", [("0.bin", "1.npy"), ("0.bin", "a0.bin"), ("01.bin", "1.bin"), ("0.bin", "0.BIN")])
def test_names_that_give_no_order(tmp_path, names):
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(SequenceError) as error:
        list_scans(tmp_path)
    assert all(name in str(error.value) for name in names)


def test_a_link_that_leads_nowhere_is_a_broken_scan(folder):
    """It is not left out in silence, which would shift the poses of those after it."""
    path = folder / "velodyne" / "000002.bin"
    path.unlink()
    path.symlink_to(folder / "absent")
    recording = open_recording(folder)
    assert len(recording) == 6
    with pytest.raises(ScanError, match=r"000002\.bin: cannot be read"):
        recording.read(2)


def test_a_broken_scan_shows_when_it_is_read(folder):
    (folder / "velodyne" / "000002.bin").write_bytes(bytes(15))
    with pytest.raises(ScanError, match=r"000002\.bin"):
        open_recording(folder).read(2)
    (folder / "velodyne" / "000003.bin").unlink()
    recording = open_recording(folder, Options(points_only=True))
    (folder / "velodyne" / "000004.bin").unlink()
    with pytest.raises(ScanError, match=r"000004\.bin"):
        recording.read(3)

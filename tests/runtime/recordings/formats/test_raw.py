import numpy as np
import pytest

from runtime.errors import ScanError, SettingError
from runtime.recordings.formats.registry import count_points, find_columns, read_cloud
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support import street


def points(count=100, columns=4):
    return np.random.default_rng(1).normal(0, 10, (count, columns)).astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, 100])
def test_bin_and_npy_files(tmp_path, count):
    scan = points(count)
    scan.tofile(tmp_path / "a.bin")
    np.save(tmp_path / "a.npy", scan.astype(np.float64))
    np.save(tmp_path / "b.npy", scan[:, :3])
    for name in ("a.bin", "a.npy"):
        np.testing.assert_array_equal(read_cloud(tmp_path / name).data, scan)
    np.testing.assert_array_equal(read_cloud(tmp_path / "b.npy").data, scan[:, :3])
    assert [count_points(tmp_path / name) for name in ("a.bin", "a.npy", "b.npy")] == [count] * 3


@pytest.mark.parametrize("size", [1, 15, 17, 12 * 5])
def test_bin_of_no_whole_number_of_points(tmp_path, size):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(size))
    for read in (read_cloud, count_points):
        with pytest.raises(ScanError, match="no whole number of points") as error:
            read(path)
        assert str(path) in str(error.value)


def test_broken_npy(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, points())
    path.write_bytes(path.read_bytes()[:300])
    for read in (read_cloud, count_points):
        with pytest.raises(ScanError, match="cannot be read"):
            read(path)
    np.save(path, np.array([{"a": 1}], object))
    with pytest.raises(ScanError, match="cannot be read"):
        read_cloud(path)
    with path.open("wb") as file:
        np.savez(file, a=points())
    with pytest.raises(ScanError, match="several arrays"):
        read_cloud(path)


@pytest.mark.parametrize("name", ["a.bin", "a.npy", "a.pcd", "a.ply", "a.las", "a.laz", "a.feather"])
def test_missing_file(tmp_path, name):
    for read in (read_cloud, count_points):
        with pytest.raises(ScanError, match=f"{name}: cannot be read"):
            read(tmp_path / name)


def with_rings(scan, rings=32):
    return np.insert(scan, 4, np.arange(len(scan)) % rings, axis=1).astype(np.float32)


def test_five_columns_are_found_by_their_rings(tmp_path):
    path = tmp_path / "a.bin"
    for scan, columns in (
        (with_rings(points(400)), 5),
        (points(400, 5), 4),
        (points(400), 4),
        (with_rings(points(20)), 4),  # too few to tell
        (np.zeros((500, 4), np.float32), 4),
        (with_rings(points(400), rings=1), 4),
        (points(0), 4),
    ):
        scan.tofile(path)
        assert find_columns((path,)) == columns
    assert find_columns((tmp_path / "absent.bin",)) == 4


def test_a_folder_of_five_columns(tmp_path):
    drive, world = street.drive(3), street.boxes()
    scans = [street.scan(pose, world) for pose in drive]
    for number, scan in enumerate(scans):
        with_rings(scan).tofile(tmp_path / f"{number}.bin")
    recording = open_recording(tmp_path, Options(points_only=True))
    for number, scan in enumerate(scans):
        read = recording.read(number)
        np.testing.assert_array_equal(read.data, scan)
        np.testing.assert_array_equal(read.ring, np.arange(len(scan)) % 32)
        assert recording.count(number) == len(scan)


@pytest.mark.parametrize("columns", [3, 5, 6])
def test_columns_as_told(tmp_path, columns):
    scan = points(60, columns)
    scan.tofile(tmp_path / "0.bin")
    read = open_recording(tmp_path, Options(points_only=True, columns=columns)).read(0)
    np.testing.assert_array_equal(read.points, scan[:, :3])
    assert read.ring is None
    with pytest.raises(SettingError, match="at least 3"):
        Options(columns=2)


def test_files_of_nuscenes(readers):
    recording = open_recording(readers / "bin5", Options(points_only=True))
    assert [recording.count(index) for index in range(2)] == [34784, 34720]
    scan = recording.read(0)
    np.testing.assert_allclose(scan.data[0], [-2.9386923, -0.10653712, -1.7480059, 22 / 255], rtol=1e-6)
    assert (scan.ring.min(), scan.ring.max(), scan.ring[1]) == (0, 31, 1)
    assert scan.remission.max() == 1

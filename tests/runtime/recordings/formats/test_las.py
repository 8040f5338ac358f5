import numpy as np
import pytest

from runtime.compute import packages
from runtime.errors import MissingPackageError, ScanError
from runtime.recordings.formats.registry import count_points, kept_points, read_cloud
from tests.support.scan_writers import write_las


@pytest.fixture
def points(scan):
    return scan[3:]  # LAS knows no NaN


@pytest.fixture(params=["a.las", "a.laz"])
def path(request, tmp_path):
    pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    return tmp_path / request.param


def test_scans_come_back(path, points):
    write_las(path, points)
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.data[:, :3], points[:, :3], atol=6e-5)
    np.testing.assert_array_equal(cloud.data[:, 3], np.round(points[:, 3] * 65535))
    assert count_points(path) == len(points)
    assert cloud.ring is None


def test_no_points(path, points):
    write_las(path, points[:0])
    assert len(read_cloud(path).data) == count_points(path) == 0


def test_intensity_that_is_nowhere_is_none(path, points):
    points[:, 3] = 0
    write_las(path, points)
    assert read_cloud(path).data.shape == (len(points), 3)


def test_cut_off(path, points):
    write_las(path, points)
    whole = path.read_bytes()
    for length in (len(whole) - 300, 100):
        path.write_bytes(whole[:length])
        with pytest.raises(ScanError, match=rf"{path.name}: (cannot be read as LAS|is cut off)"):
            read_cloud(path)


@pytest.mark.parametrize("at", [100, 107, 243, 247, "chunks"])
def test_more_than_there_is(path, points, at):
    """A few bytes that speak of gigabytes: lazrs would abort the process, laspy fill all memory."""
    write_las(path, points)
    data = bytearray(path.read_bytes())
    data[25] = max(data[25], 4 if at in (243, 247) else 0)
    if at == "chunks":
        if path.suffix == ".las":
            pytest.skip("has no chunks")
        begin = int.from_bytes(data[96:100], "little")
        at = int.from_bytes(data[begin : begin + 8], "little") + 4
    data[at : at + 4] = b"\xff" * 4
    path.write_bytes(data)
    for read in (read_cloud, count_points):
        with pytest.raises(ScanError, match="speaks of more than it has bytes for"):
            read(path)


def test_what_unpacks_panics_over(path, points, capfd):
    """By what is no Exception; and in threads of its own it would end the process."""
    if path.suffix == ".las":
        pytest.skip("is not packed")
    write_las(path, points)
    data = bytearray(path.read_bytes())
    record = data.index(b"laszip encoded") + 16 + 2 + 2 + 32  # behind the record's head
    data[record + 32 : record + 34] = bytes(2)  # how many parts a point has
    path.write_bytes(data)
    with pytest.raises(ScanError, match="cannot be read as LAS"):
        read_cloud(path)
    assert "panicked" in capfd.readouterr().err


def test_scales_beyond_all_numbers(path, points):
    write_las(path, points)
    data = bytearray(path.read_bytes())
    data[131:139] = np.float64(1e308).tobytes()
    path.write_bytes(data)
    keep = np.ones(len(read_cloud(path).data), np.bool_)
    assert not np.isfinite(read_cloud(path).data[:, 0]).all()
    kept_points(path, keep)


def test_a_header_that_cannot_be_written_again(path, points):
    write_las(path, points)
    data = bytearray(path.read_bytes())
    data[26] = 0xE4  # the first letter of the system's name, which is to be ASCII
    path.write_bytes(data)
    keep = np.ones(len(read_cloud(path).data), np.bool_)
    with pytest.raises(ScanError, match="cannot be written again"):
        kept_points(path, keep)


def test_without_the_package(path, points, monkeypatch):
    write_las(path, points)
    monkeypatch.setattr(packages, "has_package", lambda name: False)
    for read in (read_cloud, count_points):
        with pytest.raises(MissingPackageError, match=r"lidar-mos\[points\]"):
            read(path)

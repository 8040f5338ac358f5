import numpy as np
import pytest

from runtime.compute import packages
from runtime.errors import MissingPackageError, ScanError
from runtime.recordings.formats.registry import count_points, read_cloud
from tests.support.scan_writers import write_pcd

ENCODINGS = ("ascii", "binary", "binary_compressed")


def written(path, scan, encoding):
    if encoding == "binary_compressed":
        pytest.importorskip("lzf")
    write_pcd(path, scan, encoding)
    return path


def header(fields="x y z", size="4 4 4", kind="F F F", points=1, data="ascii", count="1 1 1"):
    lines = ["VERSION 0.7", f"FIELDS {fields}", f"SIZE {size}", f"TYPE {kind}", f"COUNT {count}", f"WIDTH {points}"]
    return "\n".join([*lines, "HEIGHT 1", f"POINTS {points}", f"DATA {data}", ""]).encode()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_scans_come_back_bit_for_bit(tmp_path, scan, encoding):
    path = written(tmp_path / "a.pcd", scan, encoding)
    np.testing.assert_array_equal(read_cloud(path).data, scan)
    assert count_points(path) == len(scan)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_no_points(tmp_path, scan, encoding):
    path = written(tmp_path / "a.pcd", scan[:0], encoding)
    assert read_cloud(path).data.shape == (0, 4)
    assert count_points(path) == 0


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_cut_off(tmp_path, scan, encoding):
    path = written(tmp_path / "a.pcd", scan, encoding)
    path.write_bytes(path.read_bytes()[:-700])
    with pytest.raises(ScanError, match=r"a\.pcd: is cut off: it holds \d+ of"):
        read_cloud(path)


def test_damaged_compression(tmp_path, scan):
    path = written(tmp_path / "a.pcd", scan, "binary_compressed")
    content = bytearray(path.read_bytes())
    content[-1000:] = bytes(1000)
    path.write_bytes(content)
    with pytest.raises(ScanError, match=r"a\.pcd: its points.* decompressed"):
        read_cloud(path)


def test_without_the_package(tmp_path, scan, monkeypatch):
    path = written(tmp_path / "a.pcd", scan, "binary_compressed")
    monkeypatch.setattr(packages, "has_package", lambda name: False)
    with pytest.raises(MissingPackageError, match=r"lidar-mos\[points\]"):
        read_cloud(path)
    write_pcd(path, scan, "binary")
    assert len(read_cloud(path).data) == len(scan)


def test_types_order_padding_and_several_numbers_a_field(tmp_path):
    record = np.dtype("<u2,<f8,V3,<f8,<f8,<u2,<f4,<f4")
    points = np.zeros(5, record)
    points["f0"], points["f1"], points["f3"], points["f4"] = range(5), range(10, 15), range(20, 25), range(30, 35)
    points["f5"] = 1000
    head = header("ring Z _ y x Intensity normal", "2 8 1 8 8 2 4", "U F U F F U F", 5, "binary", count="1 1 3 1 1 1 2")
    (tmp_path / "a.pcd").write_bytes(head + points.tobytes())
    cloud = read_cloud(tmp_path / "a.pcd")
    np.testing.assert_array_equal(cloud.data[2], np.float32([32, 22, 12, 1000]))
    np.testing.assert_array_equal(cloud.ring, range(5))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is no whole PCD file"),
        (header()[:60], "has no DATA"),
        (header(kind="F F"), "no PCD header"),
        (header(size="4 4 x"), "no PCD header"),
        (header(size="4 4 3"), "no PCD header"),
        (header(points=-1), "no PCD header"),
        (header(kind="F F 0"), "no PCD header"),
        (header(count=f"1 1 {10**30}"), "no PCD header"),
        (header(count="0 0 0", data="binary"), "no PCD header"),
        (header(data="zip"), "DATA zip"),
        (header("a b c", points=0), "has no field x, y, z; its fields are a, b, c"),
        (header() + b"1 2 three", "not made of numbers"),
        (header() + b"1 2", "0 of its 1 points"),
    ],
)
def test_wrong_files(tmp_path, content, message):
    path = tmp_path / "a.pcd"
    path.write_bytes(content)
    with pytest.raises(ScanError, match=message) as error:
        read_cloud(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("name", "count", "first", "ring"),
    [
        ("ascii.pcd", 213, (0.93773, 0.33763, 0), None),
        ("ascii_multi_count.pcd", 8, (0, 0, 0), None),  # four numbers are no remission
        ("ascii_organized.pcd", 8, (0, 0, 0, 0.1), None),
        ("ascii_with_empty_points.pcd", 0, None, None),
        ("ascii_with_underscore.pcd", 213, (0.93773, 0.33763, 0), None),
        ("binary.pcd", 213, (0.93773, 0.33763, 0), None),
        ("binary_compressed.pcd", 213, (0.93773, 0.33763, 0), None),
        ("binary_compressed_organized.pcd", 8, (0, 0, 0, 0.1), None),
        ("nebula_vlp16_xyzircaedt.pcd", 14831, (0.96583873, -0.00522574, 0.01685902, 100), 8),
        ("os0-64_binary_pointxyzinormal.pcd", 73452, (-8.208431, 0.86065745, 8.384442, 8), None),
        ("pandar40p_binary_timestamp_ring.pcd", 68242, (-0.014022252, 32.136631, 4.0273242, 6), 0),
        ("vlp16_ascii_xyz.pcd", 22988, (-1.14, 0, -0.3), None),
        ("vlp16_binary_padded_ring.pcd", 15753, (-5.8486404, -20.013752, 0.36395246, 5), 8),
    ],
)
def test_files_of_other_projects(readers, name, count, first, ring):
    if "compressed" in name:
        pytest.importorskip("lzf")
    path = readers / "pcd" / name
    cloud = read_cloud(path)
    assert len(cloud.data) == count_points(path) == count
    if first is not None:
        np.testing.assert_allclose(cloud.data[0], first, rtol=1e-6)
    assert (None if cloud.ring is None else cloud.ring[0]) == ring


def test_a_header_that_misplaces_its_fields(readers):
    """It has padding of no bytes: times lie 4 bytes behind where it has them, rings 2 before."""
    cloud = read_cloud(readers / "pcd" / "pandar40p_binary_timestamp_ring.pcd")
    assert np.isfinite(cloud.data).all()
    assert 0 <= cloud.data[:, 3].min() <= cloud.data[:, 3].max() == 255
    np.testing.assert_array_equal(np.unique(cloud.ring), np.arange(40))
    turn = np.unwrap(np.arctan2(cloud.data[:, 1], cloud.data[:, 0]))
    assert np.corrcoef(turn, cloud.times)[0, 1] < -0.999


@pytest.mark.parametrize("name", ["ascii_empty.pcd", "ascii_invalid_header.pcd"])
def test_broken_files_of_other_projects(readers, name):
    with pytest.raises(ScanError, match=f"{name}: is no whole PCD file: its header has no FIELDS"):
        read_cloud(readers / "pcd" / name)

import numpy as np
import pytest

from runtime.errors import ScanError
from runtime.recordings.formats.registry import count_points, read_cloud
from tests.support.scan_writers import PLY_FORMATS, write_ply


@pytest.mark.parametrize("encoding", PLY_FORMATS)
def test_scans_come_back_bit_for_bit(tmp_path, scan, encoding):
    path = tmp_path / "a.ply"
    for points in (scan, scan[:0]):
        write_ply(path, points, encoding)
        np.testing.assert_array_equal(read_cloud(path).data, points)
        assert count_points(path) == len(points)


@pytest.mark.parametrize("encoding", PLY_FORMATS)
def test_cut_off(tmp_path, scan, encoding):
    path = tmp_path / "a.ply"
    write_ply(path, scan, encoding)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ScanError, match=r"a\.ply: is cut off: it holds \d+ of 200 rows of its element 'vertex'"):
        read_cloud(path)


HEAD = """ply
format {}
comment the faces come first
element face 2
property list uchar int vertex_indices
element vertex 3
property ushort ring
property double x
property list uint8 float32 waveform
property double y
property float z
property uchar reflectivity
end_header
"""
ROWS = [(1, 1.5, [9.0], 2.5, 3.5, 7), (2, 4.0, [], 5.0, 6.0, 255), (3, 7.0, [1.0, 2.0, 3.0], 8.0, 9.0, 0)]


def in_text():
    rows = [f"{ring} {x} {len(wave)} {' '.join(map(str, wave))} {y} {z} {i}" for ring, x, wave, y, z, i in ROWS]
    return HEAD.format("ascii 1.0") + "3 0 1 2\n2 0 1\n" + "\n".join(rows) + "\n"


def in_bytes(name, order):
    parts = [HEAD.format(f"{name} 1.0").encode()]
    for face in ([0, 1, 2], [0, 1]):
        parts += [bytes([len(face)]), np.array(face, order + "i4").tobytes()]
    for ring, x, wave, y, z, i in ROWS:
        parts += [np.array(ring, order + "u2").tobytes(), np.array(x, order + "f8").tobytes(), bytes([len(wave)])]
        parts += [np.array(wave, order + "f4").tobytes(), np.array(y, order + "f8").tobytes()]
        parts += [np.array(z, order + "f4").tobytes(), bytes([i])]
    return b"".join(parts)


@pytest.mark.parametrize("encoding", PLY_FORMATS)
def test_other_elements_and_lists_are_skipped(tmp_path, encoding):
    path = tmp_path / "a.ply"
    path.write_bytes(in_bytes(encoding, PLY_FORMATS[encoding]) if PLY_FORMATS[encoding] else in_text().encode())
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.data, [[1.5, 2.5, 3.5, 7], [4, 5, 6, 255], [7, 8, 9, 0]])
    np.testing.assert_array_equal(cloud.ring, [1, 2, 3])
    assert count_points(path) == 3
    if encoding != "ascii":
        path.write_bytes(path.read_bytes()[:-20])
        with pytest.raises(ScanError, match="is cut off: it holds 2 of 3 rows"):
            read_cloud(path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("ply\nformat ascii 1.0\nelement vertex 3\n", "does not end"),
        ("ply\nformat text 1.0\nend_header\n", "no PLY header: format text"),
        ("ply\nelement vertex 1\nproperty float x\nend_header\n", "no PLY header: property float x"),
        ("ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "no PLY header: element vertex many"),
        ("ply\nformat ascii 1.0\nelement vertex 0\nproperty half x\nend_header\n", "no PLY header: property half x"),
        ("ply\nformat ascii 1.0\nproperty float x\nend_header\n", "no PLY header: property float x"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nend_header\n1 2 3\n", "no field x, y, z"),
        ("ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "no PLY header: element vertex -1"),
        (
            "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty list uint int x\nend_header\n",
            "no PLY header: property list uint int x",
        ),
        ("ply\nformat ascii 1.0\nelement face 0\nend_header\n", "no element 'vertex'; its elements are face"),
        ("ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n", "no field y, z; its fields are x"),
        ("ply\nformat binary_little_endian 1.0\nelement face 0\nend_header\n", "no element 'vertex'"),
        (
            "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
            "end_header\n1 2 3 4\n1 2 3 4\n1 2\n",
            "hold more than its 3 properties",
        ),
        (
            f"ply\nformat binary_little_endian 1.0\nelement vertex {10**15}\nproperty list uint int x\nend_header\n",
            "holds 0 of",
        ),
    ],
)
def test_wrong_headers(tmp_path, header, message):
    path = tmp_path / "a.ply"
    path.write_text(header)
    with pytest.raises(ScanError, match=message) as error:
        read_cloud(path)
    assert str(path) in str(error.value)


def test_a_sweep_of_argoverse_1(readers):
    path = readers / "ply" / "argoverse1.ply"
    cloud = read_cloud(path)
    assert len(cloud.data) == count_points(path) == 91083
    content = path.read_bytes()
    first = np.frombuffer(content, "<f4", 3, content.index(b"end_header\n") + 11)
    np.testing.assert_array_equal(cloud.data[0, :3], first)
    assert np.isfinite(cloud.data).all()
    assert cloud.data[:, 3].max() == 255
    assert (cloud.ring.min(), cloud.ring.max()) == (0, 31)

"""Files of one scan without some of their points: all else about them is as it was."""

import shutil

import numpy as np
import pytest

from runtime.errors import ScanError
from runtime.recordings.formats.registry import kept_points, read_cloud
from runtime.recordings.formats.writing import WRITERS
from tests.support import scan_writers

SCAN = np.random.default_rng(0).uniform(-30, 30, (500, 4)).astype(np.float32)
KEEP = np.arange(500) % 7 != 0


def check(path, keep=KEEP, columns=4):
    """The kept points are those of the file, in their order."""
    before = read_cloud(path, columns)
    copy = path.with_name(f"kept_{path.name}")
    copy.write_bytes(kept_points(path, keep, columns))
    after = read_cloud(copy, columns)
    np.testing.assert_array_equal(after.data, before.data[keep])
    for name in ("ring", "times"):
        one, other = getattr(before, name), getattr(after, name)
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_array_equal(other, one[keep])
    return copy.read_bytes()


@pytest.mark.parametrize("keep", [KEEP, np.zeros(500, bool), np.ones(500, bool)])
def test_every_format_that_is_written_by_hand(tmp_path, keep):
    SCAN.tofile(tmp_path / "a.bin")
    np.save(tmp_path / "a.npy", SCAN.astype(np.float64))
    check(tmp_path / "a.bin", keep)
    check(tmp_path / "a.npy", keep)
    for encoding in scan_writers.PLY_FORMATS:
        scan_writers.write_ply(tmp_path / f"{encoding}.ply", SCAN, encoding)
        text = check(tmp_path / f"{encoding}.ply", keep)
        assert text.startswith(f"ply\nformat {encoding} 1.0\ncomment by hand\nelement vertex {keep.sum()}\n".encode())
    for encoding in ("ascii", "binary"):
        scan_writers.write_pcd(tmp_path / f"{encoding}.pcd", SCAN, encoding)
        check(tmp_path / f"{encoding}.pcd", keep)
        if keep.all():
            assert kept_points(tmp_path / f"{encoding}.pcd", keep) == (tmp_path / f"{encoding}.pcd").read_bytes()
    for form, write in WRITERS.items():
        columns = {"x": SCAN[:, 0], "y": SCAN[:, 1], "z": SCAN[:, 2], "intensity": SCAN[:, 3]}
        (tmp_path / f"own.{form}").write_bytes(write(columns))
        np.testing.assert_array_equal(read_cloud(tmp_path / f"own.{form}").data, SCAN)
        check(tmp_path / f"own.{form}", keep)


def test_compressed_pcd(tmp_path):
    pytest.importorskip("lzf")
    scan_writers.write_pcd(tmp_path / "a.pcd", SCAN, "binary_compressed")
    for keep in (KEEP, np.zeros(500, bool)):
        check(tmp_path / "a.pcd", keep)


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_las(tmp_path, suffix):
    pytest.importorskip("laspy")
    scan_writers.write_las(tmp_path / f"a.{suffix}", SCAN)
    check(tmp_path / f"a.{suffix}")


def test_five_columns(tmp_path):
    np.column_stack([SCAN, np.arange(500) % 32]).astype("<f4").tofile(tmp_path / "a.bin")
    check(tmp_path / "a.bin", columns=5)


def test_files_of_other_projects(readers, tmp_path):
    """Organised clouds, padding, several numbers a field, rings, times."""
    found = 0
    for path in sorted(readers.rglob("*")):
        if path.suffix in (".pcd", ".ply", ".feather"):
            try:
                count = len(read_cloud(path).data)
            except (ScanError, ImportError):  # one of the bad ones, or no scan
                continue
            copy = tmp_path / path.name
            shutil.copy(path, copy)
            check(copy, np.arange(count) % 3 != 0)
            found += 1
    assert found > 5


def test_points_that_other_rows_name_cannot_be_left_out(tmp_path):
    (tmp_path / "a.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    with pytest.raises(ScanError, match="has face beside its points"):
        kept_points(tmp_path / "a.ply", np.array([True, False, True]))


@pytest.mark.parametrize(
    ("name", "head"),
    [
        (
            "a.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\n"
            + "".join(f"property float {x}\n" for x in "xyz")
            + "end_header\n",
        ),
        ("a.pcd", "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA ascii\n"),
    ],
)
@pytest.mark.parametrize("lines", ["0 0 0 1\n0 0 0 1 0\n", "0 0 0\n1 0\n0\n0 1 0\n"])
def test_points_that_are_no_line_each_cannot_be_left_out(tmp_path, name, head, lines):
    """Nor is a file half written whose lines are others than its points."""
    (tmp_path / name).write_text(head + lines)
    assert len(lines.split()) == 9
    with pytest.raises(ScanError):
        kept_points(tmp_path / name, np.arange(len(read_cloud(tmp_path / name).data)) < 2)

import shutil

import numpy as np
import pytest

from runtime.errors import MosWarning, PoseError, ScanError, SequenceError, SettingError
from runtime.recordings.sequence import find_sequences, list_scans, open_sequence
from tests.support import street


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A root with the KITTI sequences 03 and 11, of six tiny scans each."""
    root = tmp_path_factory.mktemp("kitti")
    for name in ("03", "11"):
        street.write_kitti(root / "sequences" / name, 6, rows=4, columns=20)
    return root


@pytest.fixture
def root(made, tmp_path):
    return shutil.copytree(made, tmp_path / "root")


@pytest.fixture
def folder(root):
    return root / "sequences" / "03"


def test_kitti_layout(folder):
    sequence = open_sequence(folder)
    assert sequence.name == "03"
    assert len(sequence) == 6
    assert [scan.name for scan in sequence.scans] == [f"{i:06d}.bin" for i in range(6)]
    drive = street.drive(6)
    np.testing.assert_allclose(sequence.poses, np.linalg.inv(drive[0]) @ drive, atol=1e-6)
    scan, pose = sequence.read(2)
    np.testing.assert_array_equal(scan, street.scan(drive[2], street.boxes(), rows=4, columns=20))
    np.testing.assert_array_equal(pose, sequence.poses[2])


@pytest.mark.parametrize("below", [".", "sequences"])
def test_sequences_are_found_under_a_root(root, below):
    assert [folder.name for folder in find_sequences(root / below)] == ["03", "11"]
    assert [folder.name for folder in find_sequences(root / below, ("11",))] == ["11"]
    with pytest.raises(SequenceError, match="no sequence 12; there are 03, 11"):
        find_sequences(root / below, ("12",))


def test_a_sequence_or_its_velodyne_folder_is_itself_found(folder):
    assert find_sequences(folder) == [folder]
    assert find_sequences(folder / "velodyne") == [folder]
    with pytest.raises(SequenceError, match="is one sequence"):
        find_sequences(folder, ("03",))


def test_nothing_to_find(tmp_path):
    with pytest.raises(SequenceError, match="holds neither"):
        find_sequences(tmp_path)
    with pytest.raises(SequenceError, match="is no folder"):
        find_sequences(tmp_path / "absent")


def test_poses_beside_the_sequences(root, folder):
    expected = open_sequence(folder).poses
    (root / "poses").mkdir()
    (folder / "poses.txt").rename(root / "poses" / "03.txt")
    np.testing.assert_array_equal(open_sequence(folder).poses, expected)


def plain(folder, count, poses, name="{:d}.npy"):
    folder.mkdir()
    for i in range(count):
        np.save(folder / name.format(i), np.full((i + 1, 3), i, np.float32))
    street.write_poses(folder / "poses.txt", poses)
    return folder


def test_plain_folder_in_natural_order_with_lidar_poses(tmp_path):
    poses = street.drive(12)
    sequence = open_sequence(plain(tmp_path / "log", 12, poses), frame="lidar")
    assert [scan.stem for scan in sequence.scans] == [str(i) for i in range(12)]
    np.testing.assert_allclose(sequence.poses, poses, atol=1e-8)
    scan, _ = sequence.read(10, remission_fill=0.25)
    assert scan.shape == (11, 4)
    assert (scan[:, 3] == 0.25).all()


def test_times_as_names_are_in_order_of_time(tmp_path):
    (tmp_path / "log").mkdir()
    for name in ("9.5", "10.45", "10.5", "10.405"):
        (tmp_path / "log" / f"{name}.bin").touch()
    assert [scan.stem for scan in list_scans(tmp_path / "log")] == ["9.5", "10.405", "10.45", "10.5"]


@pytest.mark.parametrize("names", [("0.bin", "1.npy"), ("0.bin", "a0.bin"), ("01.bin", "1.bin")])
def test_names_that_give_no_order(tmp_path, names):
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(SequenceError) as error:
        list_scans(tmp_path)
    assert all(name in str(error.value) for name in names)


def test_missing_poses_and_calibration_are_named(folder):
    (folder / "calib.txt").rename(folder / "other.txt")
    with pytest.raises(PoseError, match=r"calib\.txt does not exist.*--calib.*--pose-frame lidar"):
        open_sequence(folder)
    assert len(open_sequence(folder, calib=folder / "other.txt")) == 6
    assert len(open_sequence(folder, frame="lidar")) == 6
    (folder / "poses.txt").rename(folder / "p.txt")
    with pytest.raises(PoseError, match=r"poses\.txt or .*03\.txt does not exist.*--poses"):
        open_sequence(folder)
    with pytest.raises(PoseError, match=r"absent\.txt does not exist"):
        open_sequence(folder, poses=folder / "absent.txt")
    assert len(open_sequence(folder, poses=folder / "p.txt", frame="lidar")) == 6


def lines(folder, change):
    path = folder / "poses.txt"
    path.write_text("".join(change(path.read_text().splitlines(keepends=True))))


def test_short_poses_are_enough_for_the_first_scans(folder):
    lines(folder, lambda rows: rows[:4])
    with pytest.raises(SequenceError, match=r"4 poses for 6 scans.*--limit 4"):
        open_sequence(folder)
    assert len(open_sequence(folder, limit=4)) == 4
    assert len(open_sequence(folder, limit=2).poses) == 2


def test_a_limit_beyond_the_end_is_the_end(folder):
    assert len(open_sequence(folder, limit=100)) == 6


def test_an_excerpt_takes_the_lines_of_its_numbers(folder):
    whole = open_sequence(folder).poses
    for i in (0, 1, 5):
        (folder / "velodyne" / f"{i:06d}.bin").unlink()
    with pytest.warns(MosWarning, match=r"6 poses for 3 scans.*\(2 to 4, from 0\)"):
        sequence = open_sequence(folder)
    np.testing.assert_array_equal(sequence.poses, whole[2:5])


def test_the_beginning_of_a_sequence_needs_no_warning(folder):
    (folder / "velodyne" / "000005.bin").unlink()
    assert len(open_sequence(folder)) == 5


def test_more_poses_than_scans_whose_names_say_nothing(tmp_path):
    folder = plain(tmp_path / "log", 3, street.drive(5), name="scan{:d}.npy")
    with pytest.raises(SequenceError, match=r"5 poses for 3 scans.*one line for each scan"):
        open_sequence(folder, frame="lidar")


@pytest.mark.parametrize("word", ["nan", "inf", "0.5"])
def test_a_bad_pose_is_named_with_its_scan(folder, word):
    lines(folder, lambda rows: [*rows[:3], word + rows[3][rows[3].index(" ") :], *rows[4:]])
    with pytest.raises(PoseError, match=r"pose 3 \(from 0, scan 000003\.bin\)"):
        open_sequence(folder)
    assert len(open_sequence(folder, limit=3)) == 3


def test_unknown_pose_frame(folder):
    with pytest.raises(SettingError, match="camera or lidar"):
        open_sequence(folder, frame="world")


def test_a_broken_scan_shows_when_it_is_read(folder):
    (folder / "velodyne" / "000002.bin").write_bytes(bytes(15))
    with pytest.raises(ScanError, match=r"000002\.bin"):
        open_sequence(folder).read(2)


def test_the_fingerprint_of_the_poses_is_that_of_their_files(folder):
    first = open_sequence(folder).poses_sha256
    assert open_sequence(folder, limit=3).poses_sha256 == first
    assert open_sequence(folder, frame="lidar").poses_sha256 != first
    lines(folder, lambda rows: [*rows[:-1], rows[0]])
    assert open_sequence(folder).poses_sha256 != first

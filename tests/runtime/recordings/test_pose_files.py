import warnings

import numpy as np
import pytest

from runtime.errors import MosWarning, PoseError, SequenceError, SettingError
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support import street


def lines(folder, change):
    path = folder / "poses.txt"
    path.write_text("".join(change(path.read_text().splitlines(keepends=True))))


def test_poses_beside_the_sequences(root, folder):
    expected = open_recording(folder).poses
    (root / "poses").mkdir()
    (folder / "poses.txt").rename(root / "poses" / "03.txt")
    np.testing.assert_array_equal(open_recording(folder).poses, expected)


def test_missing_poses_and_calibration_are_named(folder):
    (folder / "calib.txt").rename(folder / "other.txt")
    with pytest.raises(PoseError, match=r"calib\.txt does not exist.*`calib`.*`frame='lidar'`"):
        open_recording(folder)
    assert len(open_recording(folder, Options(calib=folder / "other.txt"))) == 6
    assert len(open_recording(folder, Options(frame="lidar"))) == 6
    (folder / "poses.txt").rename(folder / "p.txt")
    with pytest.raises(PoseError, match=r"poses\.txt or .*03\.txt does not exist.*`poses`"):
        open_recording(folder)
    with pytest.raises(PoseError, match=r"absent\.txt does not exist"):
        open_recording(folder, Options(poses=folder / "absent.txt"))
    assert len(open_recording(folder, Options(poses=folder / "p.txt", frame="lidar"))) == 6


def test_options_that_contradict_each_other(folder):
    with pytest.raises(SettingError, match="camera or lidar"):
        open_recording(folder, Options(frame="world"))
    with pytest.raises(SettingError, match="need no calibration"):
        open_recording(folder, Options(frame="lidar", calib=folder / "calib.txt"))
    with pytest.raises(SettingError, match="at least 1, not 0"):
        open_recording(folder, Options(limit=0))


def test_short_poses_are_enough_for_the_first_scans(folder):
    lines(folder, lambda rows: rows[:4])
    with pytest.raises(SequenceError, match=r"4 poses for 6 scans.*`limit=4`"):
        open_recording(folder)
    assert len(open_recording(folder, Options(limit=4))) == 4
    assert len(open_recording(folder, Options(limit=2)).poses) == 2


def test_a_limit_beyond_the_end_is_the_end(folder):
    assert len(open_recording(folder, Options(limit=100))) == 6


def test_an_excerpt_takes_the_lines_of_its_numbers(folder):
    whole = open_recording(folder).poses
    for i in (0, 1, 5):
        (folder / "velodyne" / f"{i:06d}.bin").unlink()
    with pytest.warns(MosWarning, match=r"6 poses for 3 scans.*\(2 to 4, from 0\)"):
        recording = open_recording(folder)
    np.testing.assert_array_equal(recording.poses, whole[2:5])


def test_the_beginning_of_a_sequence_needs_no_warning(folder):
    (folder / "velodyne" / "000005.bin").unlink()
    assert len(open_recording(folder)) == 5


def test_more_poses_than_scans_whose_names_say_nothing(tmp_path):
    for i in range(3):
        np.save(tmp_path / f"scan{i}.npy", np.zeros((1, 3)))
    street.write_poses(tmp_path / "poses.txt", street.drive(5))
    with pytest.raises(SequenceError, match=r"5 poses for 3 scans.*one line for each scan"):
        open_recording(tmp_path, Options(frame="lidar"))


@pytest.mark.parametrize("word", ["nan", "inf", "0.5"])
def test_a_bad_pose_is_named_with_its_scan(folder, word):
    def spoil(rows):
        return [*rows[:3], *(word + row[row.index(" ") :] for row in rows[3:])]

    lines(folder, spoil)
    with pytest.raises(PoseError, match=r"pose 3 \(from 0, scan 000003\.bin\).* and 2 more") as error:
        open_recording(folder)
    assert "pose 4" not in str(error.value)
    assert len(open_recording(folder, Options(limit=3))) == 3


def test_a_bad_pose_may_be_an_error_of_its_scan(folder):
    lines(folder, lambda rows: [*rows[:3], "nan" + rows[3][rows[3].index(" ") :], *rows[4:]])
    recording = open_recording(folder, Options(skip_broken=True))
    assert len(recording.read(2).data) == len(recording.read(4).data) == recording.count(2)
    with pytest.raises(PoseError, match=r"pose 3.*NaN"):
        recording.read(3)


def test_poses_of_three_decimals_are_made_rigid(folder):
    """The rows of a rotation of three decimals are no unit vectors any more."""
    good = open_recording(folder).poses
    path = folder / "poses.txt"
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn[:3, :3] *= np.linalg.det(turn[:3, :3])
    rows = np.loadtxt(path).reshape(-1, 3, 4)
    rows = turn[:3, :3] @ rows  # another world, the same drive
    np.savetxt(path, rows.reshape(-1, 12), fmt="%.3f")
    got = open_recording(folder).poses
    rotation = got[:, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.tile(np.eye(3), (6, 1, 1)), atol=1e-3)
    np.testing.assert_allclose(got, good, atol=0.01)


def test_where_poses_are_from(root, folder):
    recording = open_recording(folder)
    assert recording.poses_from == "poses.txt and calib.txt, camera"
    assert open_recording(folder, Options(limit=3)).poses_from == recording.poses_from
    assert open_recording(folder, Options(frame="lidar")).poses_from == "poses.txt, lidar"
    (root / "poses").mkdir()
    (folder / "poses.txt").rename(root / "poses" / "03.txt")
    assert open_recording(folder).poses_from == "../../poses/03.txt and calib.txt, camera"
    root.rename(root.with_name("moved"))
    assert open_recording(root.with_name("moved"), name="03").poses_from == "../../poses/03.txt and calib.txt, camera"


def write_times(folder, times):
    (folder / "times.txt").write_text("".join(f"{time:e}\n" for time in times))


def test_times(folder):
    write_times(folder, 0.1 * np.arange(6))
    recording = open_recording(folder)
    np.testing.assert_allclose(recording.times, 0.1 * np.arange(6))
    assert recording.read(3).time == pytest.approx(0.3)
    assert isinstance(recording.read(3).time, float)


def test_times_of_an_excerpt_are_those_of_its_numbers(folder):
    write_times(folder, 0.1 * np.arange(6))
    for i in (0, 1, 5):
        (folder / "velodyne" / f"{i:06d}.bin").unlink()
    with pytest.warns(MosWarning, match="6 poses for 3 scans") as told:
        recording = open_recording(folder)
    assert len(told) == 1
    np.testing.assert_allclose(recording.times, [0.2, 0.3, 0.4])


def test_times_of_no_use_are_seen_in_the_whole_file(folder):
    write_times(folder, np.zeros(6))
    with pytest.warns(MosWarning, match="no seconds"):
        assert open_recording(folder, Options(limit=1)).times is None


def test_enough_times_for_the_first_scans(folder):
    write_times(folder, 0.1 * np.arange(4))
    lines(folder, lambda rows: rows[:4])
    assert len(open_recording(folder, Options(limit=4)).times) == 4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0.1 0.2", "2 times for 6 scans"),
        ("now", "not made of numbers"),
        ("0 0.1 0.2 nan 0.4 0.5", "not made of numbers"),
        ("", "0 times"),
        ("0 0 0 0 0 0", "no seconds"),
        ("0 100 200 300 400 500", "no seconds"),
        ("5 4 3 2 1 0", "no seconds"),
    ],
)
def test_broken_times_are_said_once_and_not_used(folder, text, words):
    (folder / "times.txt").write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = open_recording(folder)
    (told,) = caught
    assert told.category is MosWarning
    assert words in str(told.message)
    assert "times.txt" in str(told.message)
    assert recording.times is None
    assert recording.read(0).time is None

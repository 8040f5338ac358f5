"""Poses that no map has, and files of very many."""

import tracemalloc

import numpy as np
import pytest

from runtime import MosRunner
from runtime.errors import PoseError
from runtime.recordings.pose_files import checked
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.poses import FARTHEST, are_good, check_pose, relative_pose
from runtime.recordings.text import to_numbers
from runtime.recordings.trajectory import poses_at
from tests.runtime.test_runner import drive
from tests.support.paths import BUNDLE


def at(x):
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


@pytest.mark.parametrize("x", [1.7e308, -1.7e308, 1e200, 2 * FARTHEST])
def test_a_place_beyond_all_maps(x):
    with pytest.raises(PoseError, match="farther than any map"):
        check_pose(at(x))
    runner = MosRunner(BUNDLE, threads=1, postprocess="none")
    (scan, pose), (other, _) = drive(2)
    runner(scan, pose)
    with pytest.raises(PoseError):
        runner(other, at(x))


def test_map_coordinates_are_poses():
    assert check_pose(at(5e6))[0, 3] == 5e6
    assert np.isfinite(relative_pose(at(FARTHEST), at(-FARTHEST))).all()


def test_between_poses_that_are_none():
    poses = np.stack([at(0), at(1.7e308), at(-1.7e308), at(3)])
    found, why = poses_at(np.array([0.1]), np.array([0, 0.1, 0.2, 0.3]), poses, "poses", longest_gap=1.0)
    assert not why
    assert found[0, 0, 3] == pytest.approx(1)


def test_all_at_once_as_one_by_one():
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, :3, 3] = rng.normal(size=(60, 3))
    poses[3, 0, 3], poses[4, 1, 1], poses[5, 3, 3], poses[6, 0, 0] = np.nan, 2, 0.5, 1 + 1e-3
    poses[7, 2, 3], poses[8, 3, 3] = 1e300, 1 + 1e-12
    good = are_good(poses)
    for index, pose in enumerate(poses):
        try:
            same = check_pose(pose) is not None and np.array_equal(check_pose(pose), pose)
        except PoseError:
            same = False
        assert same or not good[index]
    assert good.sum() >= 54
    found, broken = checked(poses, {}, [str(i) for i in range(60)], skip_broken=True)
    assert set(broken) == {3, 4, 5, 7}
    assert np.isfinite(found[6]).all()


def test_a_file_of_very_many(tmp_path):
    """Each line costs little: a million of them are a matter of seconds."""
    line = "1 0 0 0.5 0 1 0 0.25 0 0 1 1.5e1\n"
    (tmp_path / "poses.txt").write_text(line * 20_000)
    tracemalloc.start()
    poses = read_pose_table(tmp_path / "poses.txt").poses
    checked(poses, {}, ["x"] * len(poses), skip_broken=False)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert poses.shape == (20_000, 4, 4)
    assert (poses[:, 2, 3] == 15).all()
    assert peak < 3000 * 20_000  # bytes


def test_numbers_as_they_were():
    assert to_numbers(["1.5D+03", "-2", "nan"])[:2] == [1500.0, -2.0]
    with pytest.raises(ValueError, match="x"):
        to_numbers(["1", "x"])

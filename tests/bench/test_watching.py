"""Drives that are wrong are noticed and drives that are right are not, in simulated streets too."""

import numpy as np
import pytest

from bench.corruption import HARMLESS, WRONG
from bench.scans import load_frames
from bench.watching import Watcher, streets
from tests.support.paths import KITTI


@pytest.fixture(scope="module")
def watcher():
    return Watcher()


@pytest.fixture(scope="module")
def drives():
    return streets(3, 21, first=9001, ego="cruise")


def test_simulated_streets(watcher, drives):
    assert [watcher.warnings(frames) for frames in drives] == [[]] * 3
    for name in ("poses at half scale", "inverted poses", "10 degrees down", "feet, poses too"):
        assert all(watcher.warnings(WRONG[name](frames)) for frames in drives), name


def test_other_sensors(watcher):
    for sensor in ("vlp16", "os1-128"):
        assert watcher.warnings(streets(1, 21, sensor, 9001)[0]) == []


@pytest.mark.skipif(not KITTI.is_dir(), reason="needs the KITTI scans in ../shared")
@pytest.mark.parametrize("name", [*WRONG, *HARMLESS])
def test_a_real_drive(watcher, name):
    said = watcher.warnings((WRONG | HARMLESS)[name](load_frames(KITTI / "90", 24)))
    assert bool(said) == (name in WRONG)


@pytest.mark.parametrize("name", [*WRONG, *HARMLESS])
def test_scans_given_are_left_as_they_are(name):
    rng = np.random.default_rng(0)
    frames = [(rng.normal(size=(100, 4)).astype(np.float32), np.eye(4)) for _ in range(4)]
    before = [(points.copy(), pose.copy()) for points, pose in frames]
    changed = (WRONG | HARMLESS)[name](frames)
    assert all(pose.shape == (4, 4) for _, pose in changed)
    for (points, pose), (points_before, pose_before) in zip(frames, before, strict=True):
        np.testing.assert_array_equal(points, points_before)
        np.testing.assert_array_equal(pose, pose_before)

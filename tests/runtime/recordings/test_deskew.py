"""Points of a sweep, brought to one time: the kernel, a naive reference, and sweeps of the simulator."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.recordings.deskew import STILL, Motion, deskewed, middle_of, span_of, velocity_to

TURNING = np.array([0.1, -0.2, 0.9, 12.0, 1.0, -0.3])
BRAKING = np.array([0.0, 0.1, 0.5, 9.0, 0.0, 0.1])


def naive(data, times, motion, reference):
    """Point by point, with matrices."""
    moved = data.copy()
    for i, (point, time) in enumerate(zip(data[:, :3].astype(float), times, strict=True)):
        if np.isfinite(point).all() and point.any():
            there = motion.at(float(time)) @ [*point, 1]
            moved[i, :3] = (np.linalg.inv(motion.at(reference)) @ there)[:3]
    return moved


def points(count, columns=4):
    rng = np.random.default_rng(count)
    data = rng.uniform(-50, 50, (count, columns)).astype(np.float32)
    return data, rng.uniform(-0.06, 0.06, count).astype(np.float32)


@pytest.mark.parametrize("motion", [STILL, Motion(TURNING, BRAKING), Motion(np.zeros(6), TURNING)])
@pytest.mark.parametrize("columns", [3, 4])
def test_the_kernel_does_what_matrices_do(motion, columns):
    data, times = points(200, columns)
    data[3] = 0
    data[5, 1] = np.nan
    data[7, 0] = np.inf
    times[9] = 0
    data.setflags(write=False)
    times.setflags(write=False)
    for reference in (0.0, 0.05, -0.03):
        got = deskewed(data, times, motion, reference)
        usual = np.isfinite(data).all(1)
        np.testing.assert_allclose(got[usual], naive(data, times, motion, reference)[usual], atol=2e-5)
        assert not np.isfinite(got[~usual, :3]).all(1).any()
        np.testing.assert_array_equal(got[:, 3:], data[:, 3:])
    assert (got[3] == 0).all()


def test_no_points_and_one():
    motion = Motion(TURNING, TURNING)
    assert deskewed(np.empty((0, 4), np.float32), np.empty(0, np.float32), motion).shape == (0, 4)
    one = np.float32([[1, 2, 3, 0.5]])
    np.testing.assert_array_equal(deskewed(one, np.float32([0.04]), motion, 0.0399999991059303), one)


def test_velocities_lead_from_pose_to_pose():
    pose, other = np.eye(4), np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec([0.3, 0.2, -1]).as_matrix(), (5e6, 4, 2)
    other[:3, :3], other[:3, 3] = Rotation.from_rotvec([0.1, 0.2, -1.1]).as_matrix(), (5e6 + 1, 4.5, 2)
    for seconds in (0.1, -0.1):
        velocity = velocity_to(pose, other, seconds)
        np.testing.assert_allclose(pose @ Motion(velocity, velocity).at(seconds), other, atol=1e-8)


def test_the_middle_of_a_sweep_is_not_moved_by_wild_times():
    times = np.linspace(0, 0.1, 10_000, dtype=np.float32)
    times[:20] = -0.9
    assert middle_of(times) == 0.05
    assert span_of(times) == pytest.approx(0.098, abs=0.002)

"""Recordings of raw sweeps, of the simulator."""

from dataclasses import replace

import numpy as np
import pytest

from runtime.recordings.around import Beginning
from runtime.recordings.deskew import STILL
from runtime.recordings.deskewed import Deskewed, deskewing
from tests.support.sweeps import Sweeps, drive

COUNT = 5


@pytest.fixture(scope="module")
def raw():
    return drive(3, COUNT, "on")


@pytest.fixture(scope="module")
def exact():
    return [frame.points for frame in drive(3, COUNT, "compensated")]


@pytest.mark.parametrize("stamp", ["start", "middle", "end"])
@pytest.mark.parametrize("times", [True, False])
def test_points_are_seen_from_the_middle_of_the_sweep(raw, exact, stamp, times):
    """Whichever time of the sweep the poses are of. What is left is how the turn does not go on steadily."""
    sweeps = Sweeps(raw, stamp, times=times)
    recording = deskewing(sweeps)
    assert isinstance(recording, Deskewed)
    for index, scan in enumerate(recording):
        before = sweeps.read(index)
        if 0 < index < COUNT - 1:  # both neighbours are known
            assert off(scan, exact[index], 0.5) < 0.01
            assert off(scan, exact[index], 0.99) < 0.15 < 1.2 < off(before, exact[index], 0.99)
            assert abs(scan.pose - raw.true_poses[index]).max() < 0.02
        np.testing.assert_array_equal(scan.remission, before.remission)
        assert (scan.times, scan.time) == (None, before.time)
        np.testing.assert_array_equal(scan.pose, recording.poses[index])


def test_what_is_of_one_time_is_left_alone(raw):
    """So are scans without poses, and a single one, whose motion nobody knows."""
    plain = Sweeps(raw)
    plain.read = lambda index: replace(Sweeps.read(plain, index), times=None)
    assert deskewing(plain) is plain
    unknown = Sweeps(raw, poses=False)
    assert deskewing(unknown) is unknown
    alone = Beginning(Sweeps(raw), 1)
    np.testing.assert_array_equal(deskewing(alone).read(0).data, alone.read(0).data)


def test_no_motion_is_taken_from_across_a_gap(raw):
    """Of time, of poses, or where an odometry was lost: the other side's goes on, or none."""
    sweeps = Sweeps(raw)
    usual = deskewing(sweeps).motion(1)
    assert (usual.before != usual.after).all()
    late = Sweeps(raw)
    late.times[2:] += 1
    far = Sweeps(raw)
    far.poses[2:, 0, 3] += 100
    broken = Sweeps(raw)
    broken.poses[2] = np.nan
    lost = Sweeps(raw)
    lost.lost = {2: "why"}
    for one in (late, far, broken, lost):
        motion = deskewing(one).motion(1)
        np.testing.assert_array_equal(motion.after, usual.before)
        np.testing.assert_array_equal(motion.before, usual.before)
    lost.lost = {1: "why", 2: "why"}
    assert deskewing(lost).motion(1) is STILL


def off(scan, exact, share):
    """How far most points (`share`) are from where they should be, m."""
    return np.quantile(np.linalg.norm(scan.points - exact[:, :3], axis=1), share)

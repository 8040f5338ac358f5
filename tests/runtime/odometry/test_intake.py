"""A runner that is given scans without poses, or points with times."""

from dataclasses import replace

import numpy as np
import pytest

from runtime.errors import LostError, MosWarning, PoseError, ScanError
from runtime.odometry.intake import Intake
from runtime.recordings.recording import Scan
from runtime.runner import MosRunner
from tests.support import street
from tests.support.paths import BUNDLE

COUNT = 10


@pytest.fixture(scope="module")
def scans():
    world, poses = street.boxes(), street.drive(COUNT)
    scanned = [street.scan(pose, world, rows=16, columns=240) for pose in poses]
    return [Scan(f"{i}", data, pose, i / 10) for i, (data, pose) in enumerate(zip(scanned, poses, strict=True))]


class Known:
    """An odometry that knows the poses, and is lost at one scan."""

    def __init__(self, scans, lost=-1):
        self.poses, self.next, self.lost = [scan.pose for scan in scans], 0, lost

    def locate(self, data, time, times):
        if self.next == self.lost:
            self.lost = -1
            raise LostError("fog")
        self.next += 1
        return self.poses[self.next - 1]


def probabilities(runner, scans):
    runner.reset()
    return [runner(scan).probability for scan in scans]


def test_poses_that_are_found_are_as_good_as_those_that_are_given(scans):
    with MosRunner(BUNDLE, threads=1) as given, MosRunner(BUNDLE, threads=1, odometry=Known(scans)) as finding:
        want = [given(scan.data, scan.pose, scan.time) for scan in scans]
        for index, scan in enumerate(scans):
            got = finding(scan.data, time=scan.time)
            np.testing.assert_array_equal(got.probability, want[index].probability)
            np.testing.assert_array_equal(got.pose, scan.pose)
        for want_one, got_one in zip(want, probabilities(given, scans), strict=True):  # as `Scan`
            np.testing.assert_array_equal(got_one, want_one.probability)
        with pytest.raises(PoseError, match=r"a scan has no pose: give it, or .*`odometry='kiss'`"):
            given(scans[0].data)
        assert given(scans[-1].data, scans[-1].pose).index == COUNT  # nothing was counted


def test_an_odometry_that_is_lost_drops_the_history(scans):
    with MosRunner(BUNDLE, threads=1, odometry=Known(scans, lost=5)) as runner:
        for scan in scans[:5]:
            runner(scan.data)
        with pytest.warns(MosWarning, match="fog: the history of past scans is dropped"):
            after = runner(scans[5].data)
    with MosRunner(BUNDLE, threads=1) as other:
        np.testing.assert_array_equal(other(scans[5]).probability, after.probability)
        other.reset()
        other(scans[4])
        with pytest.warns(MosWarning, match="rain: the history"):  # as a recording says it
            got = other(replace(scans[5], lost="rain"))
    np.testing.assert_array_equal(got.probability, after.probability)


def test_points_with_times_are_brought_to_the_middle_of_the_sweep(scans):
    """By the motion since the scan before; the same that a recording does where the motion is steady."""
    intake, left = Intake(None, True), Intake(None, False)
    step = np.eye(4)
    step[0, 3] = 1.0
    times = np.linspace(0, 0.1, len(scans[0].data), dtype=np.float32)
    first = intake.take(scans[0].data, np.eye(4), 0.0, times)
    np.testing.assert_array_equal(first.data, scans[0].data)  # of the first scan nobody knows how it moved
    intake.keep(first)
    second = intake.take(scans[0].data, step, 0.1, times)
    moved = np.asarray(second.data)[:, 0] - scans[0].data[:, 0]
    np.testing.assert_allclose(moved, 10 * (times - 0.05), atol=1e-4)
    assert second.pose[0, 3] == pytest.approx(1.5)
    plain = left.take(scans[0].data, step, 0.1, times)
    assert plain.data is scans[0].data
    np.testing.assert_array_equal(plain.pose, step)
    with pytest.raises(ScanError, match="times must be one for each of the points"):
        intake.take(scans[0].data, step, 0.2, times[1:])


def test_kiss_icp_begins_anew_with_each_sequence(scans):
    pytest.importorskip("kiss_icp")
    with MosRunner(BUNDLE, threads=1, odometry="kiss") as runner:
        for _ in range(2):
            runner.reset()
            np.testing.assert_array_equal(runner(scans[3].data).pose, np.eye(4))
            assert abs(runner(scans[4].data).pose - np.eye(4)).max() > 0.1

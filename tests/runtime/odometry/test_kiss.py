"""KISS-ICP in a street of known poses."""

import numpy as np
import pytest

from runtime.errors import LostError, MosWarning

pytest.importorskip("kiss_icp")

from runtime.odometry.kiss import KissOdometry


def located(scans):
    odometry = KissOdometry()
    return np.array([odometry.locate(scan.data, scan.time, scan.times) for scan in scans])


def wrong_steps(poses, scans):
    """By how much the steps from pose to pose are wrong, m."""
    true = np.array([scan.pose for scan in scans])
    steps, wanted = (np.linalg.inv(found[:-1]) @ found[1:] for found in (poses, true))
    return np.linalg.norm((np.linalg.inv(wanted) @ steps)[:, :3, 3], axis=1)


def test_poses_are_those_of_the_drive_to_the_same_bits(scans):
    poses = located(scans)
    np.testing.assert_array_equal(poses[0], np.eye(4))
    assert wrong_steps(poses, scans).max() < 0.12  # of 0.36
    assert np.median(wrong_steps(poses, scans)) < 0.05
    np.testing.assert_array_equal(located(scans[:6]), poses[:6])


def test_raw_sweeps_are_located_at_their_stamps(raw):
    """From the second on: of the first nobody knows how it moved."""
    assert wrong_steps(located(raw), raw)[1:].max() < 0.12


def test_what_is_no_point_counts_nothing(scans):
    wild = np.float32([[0, 0, 0, 0], [np.nan, 0, 0, 0], [np.inf, 0, 0, 0], [400, 0, 0, 0]])
    odometry = KissOdometry()
    poses = [odometry.locate(np.concatenate([scan.data, wild]), scan.time) for scan in scans[:3]]
    np.testing.assert_array_equal(poses, located(scans[:3]))


def test_one_scan_and_standing_still(scans):
    poses = located([scans[3]] * 5)
    np.testing.assert_array_equal(poses[0], np.eye(4))
    assert abs(poses - np.eye(4)).max() < 0.01


def test_a_scan_without_points_is_guessed_and_said(scans):
    odometry = KissOdometry()
    poses = [odometry.locate(scan.data, scan.time) for scan in scans[:6]]
    with pytest.warns(MosWarning, match="a scan has 0 points within 100 m"):
        poses.append(odometry.locate(scans[6].data[:0], scans[6].time))
    poses.append(odometry.locate(scans[7].data, scans[7].time))
    assert wrong_steps(np.array(poses), scans[:8]).max() < 0.15


def test_scans_of_another_unit_are_said(scans):
    with pytest.warns(MosWarning, match="within 100 m"):
        KissOdometry().locate(scans[0].data * 1000)


def test_a_dropped_scan_is_known_by_the_time(scans):
    """Constant velocity takes it twice as far."""
    some = [*scans[:4], *scans[5:7]]
    assert wrong_steps(located(some), some).max() < 0.12


def test_what_has_nothing_in_common_is_lost_and_begun_anew(scans):
    odometry = KissOdometry()
    for scan in scans[:5]:
        before = odometry.locate(scan.data)
    other = scans[5].data.copy()
    other[:, :2] = other[:, 1::-1] * (-1, 1)  # turned by 90 degrees
    with pytest.raises(LostError, match=r"\d+% in common with the scan before"):
        odometry.locate(other)
    again = odometry.locate(other)
    assert np.linalg.norm(again[:3, 3] - before[:3, 3]) < 2  # where it was thought to be
    np.testing.assert_allclose(odometry.locate(other), again, atol=0.01)

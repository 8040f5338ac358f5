import logging

import numpy as np
import pytest

from runtime.recordings.cloud import Cloud
from runtime.recordings.formats.registry import read_cloud
from runtime.recordings.point_times import PointTimes

TURN = np.linspace(0, 0.1, 500)  # s
STAMP = 1_700_000_000.25  # s


def seconds(times, scan=None, others=()):
    clouds = [Cloud(np.zeros((len(one), 3), np.float32), times=one) for one in (times, *others)]
    return PointTimes("drive", lambda: clouds).seconds(times, scan)


@pytest.mark.parametrize(
    "times",
    [
        np.round(TURN * 1e9).astype(np.uint32),  # Ouster
        TURN.astype(np.float32),  # Velodyne's LiDARs in ROS
        STAMP + TURN,  # Hesai
        np.round((STAMP + TURN) * 1e9).astype(np.uint64),
        (STAMP + TURN) * 1e6,
        TURN * 1e3,
    ],
)
def test_units_and_clocks(times):
    found = seconds(times, STAMP)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, TURN, atol=1e-6)


def test_the_stamp_may_be_that_of_the_end():
    np.testing.assert_allclose(seconds((TURN - 0.1).astype(np.float32), STAMP), TURN - 0.1, atol=1e-6)
    np.testing.assert_allclose(seconds(STAMP + TURN, STAMP + 0.1), TURN - 0.1, atol=1e-6)


def test_another_clock_counts_from_the_first_point():
    for scan in (None, STAMP):
        np.testing.assert_allclose(seconds(1818.8 + TURN, scan), TURN, atol=1e-6)


def test_points_without_a_time_have_that_of_the_scan():
    times = STAMP + TURN
    times[::3] = 0
    times[1::3] = np.nan
    found = seconds(times, STAMP)
    np.testing.assert_allclose(found[2::3], TURN[2::3], atol=1e-6)
    assert not found[::3].any()
    assert not found[1::3].any()


def test_the_first_scans_tell_the_unit():
    """This one alone could be of 0.3 s in microseconds."""
    part = np.round(TURN * 1e9).astype(np.uint32)[:2]
    np.testing.assert_allclose(seconds(part, STAMP, [np.round(TURN * 1e9)]), TURN[:2], atol=1e-6)


@pytest.mark.parametrize("times", [np.zeros(9), np.arange(5), np.full(9, np.nan), np.zeros(0), TURN * 3e7])
def test_what_is_no_turn_is_not_used(times, caplog):
    caplog.set_level(logging.INFO, "lidar_mos")
    assert seconds(times, STAMP) is None
    assert ("no turn" in caplog.text) == bool(np.nan_to_num(times).any())


@pytest.mark.parametrize(
    ("name", "turn", "rings"),
    [
        ("pcd/pandar40p_binary_timestamp_ring.pcd", 0.1003, 40),
        ("pcd/nebula_vlp16_xyzircaedt.pcd", None, 16),  # of 1.3 ms: within one packet
        ("feather/315966265259836000.feather", 0.1034, 64),
    ],
)
def test_files_of_other_projects(readers, name, turn, rings):
    if name.startswith("feather"):
        pytest.importorskip("pyarrow")
    cloud = read_cloud(readers / name)
    found = PointTimes(name, lambda: [cloud]).seconds(cloud.times, None)
    assert cloud.ring.max() == rings - 1
    if turn is None:
        assert found is None
    else:
        assert np.ptp(found) == pytest.approx(turn, abs=1e-4)
        assert found.min() >= 0

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mos_model.simulator import simulate
from mos_model.simulator.scene import MOVING_SPEED, STANDING_SPEED
from runtime.errors import SettingError

STATIC_CLASSES = (10, 50, 51, 80)  # with sharp surfaces


def in_world(frame, pose=None):
    pose = frame.true_pose if pose is None else pose
    return frame.points[:, :3] @ pose[:3, :3].T + pose[:3, 3]


def test_the_same_seed_gives_the_same_data_in_any_order():
    one, two = simulate(7, 4), simulate(7, 4)
    late = two[3]
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal(a.labels, b.labels)
        np.testing.assert_array_equal(a.pose, b.pose)
    np.testing.assert_array_equal(late.points, one[3].points)
    assert simulate(8, 1)[0].points.shape != one[0].points.shape


@pytest.mark.parametrize(
    ("seed", "sensor", "prims", "tracks", "points", "moving"),
    [
        (41, "vlp16", 1324, 37, 23185, 1041),
        (43, "hdl32e", 1788, 45, 61836, 803),
        (60, "hdl64e", 1104, 36, 118049, 5720),
    ],
)
def test_version_1_stays_as_it_was(seed, sensor, prims, tracks, points, moving):
    """Recorded when there was one version; the last digits are a matter of the processor."""
    drive = simulate(seed, 4, sensor)
    frame = drive[3]
    assert (len(drive.scene.prims), len(drive.traffic.tracks)) == (prims, tracks)
    assert len(frame.points) == pytest.approx(points, rel=1e-4)
    assert ((frame.labels & 0xFFFF) > 250).sum() == pytest.approx(moving, rel=1e-3)


def test_a_scan_is_what_a_reader_expects():
    drive = simulate(11, 3)
    assert len(drive) == 3
    frame = drive[1]
    assert frame.points.dtype == np.float32
    assert frame.points.shape == (len(frame.labels), 4)
    assert frame.labels.dtype == np.uint32
    assert np.isfinite(frame.points).all()
    assert 0 <= frame.points[:, 3].min() <= frame.points[:, 3].max() <= 1
    assert 60_000 < len(frame.points) < 138_000
    rotation = frame.pose[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    with pytest.raises(IndexError):
        drive[3]


@pytest.mark.parametrize(("seed", "street"), [(1, "urban"), (2, "residential"), (3, "highway"), (5, "open")])
def test_labels_follow_the_speed_at_the_time_of_the_scan(seed, street):
    drive = simulate(seed, 12, street=street, movers=2.5)
    moving_seen = 0
    for k in (2, 10):
        frame = drive[k]
        kind, instance = frame.labels & 0xFFFF, (frame.labels >> 16).astype(int)
        for i, track in enumerate(drive.traffic.tracks):
            mine = instance == drive.scene.instance(i)
            mine &= (kind > 250) | (kind == 0)
            way = track.states[k + 1, :2] - track.states[k - 1, :2]
            speed = np.hypot(*way) / 0.2
            if mine.any() and (kind[mine] > 250).any():
                moving_seen += mine.sum()
                assert speed > MOVING_SPEED - 0.15
                away = np.linalg.norm(in_world(frame)[mine][:, :2] - track.states[k, :2], axis=1)
                # A sweep lasts 0.1 s: what is seen early or late in it lies elsewhere in the scan.
                assert np.quantile(away, 0.9) < 0.5 * track.length + 1.5 + 0.1 * track.states[k, 3] + 2.5
            elif speed > MOVING_SPEED + 0.15:
                assert not mine.any()
        standing = [i for i, t in enumerate(drive.traffic.tracks) if t.states[k, 3] < STANDING_SPEED]
        ids = [drive.scene.instance(i) for i in standing]
        assert not (kind[np.isin(instance, ids)] > 250).any()
    assert moving_seen > 100


def test_no_mover_no_moving_label():
    drive = simulate(3, 6, movers=0)
    assert drive.traffic.tracks == []
    for frame in drive:
        assert not ((frame.labels & 0xFFFF) > 250).any()


def test_most_drives_have_movers_and_some_have_none():
    counts = [len(simulate(seed, 1).traffic.tracks) for seed in range(24)]
    assert 0 in counts
    assert sum(c > 3 for c in counts) > 14


def nearest(a, b, pose_a, pose_b, reach=25.0):
    """Median distance of the sharp static points of scan a to those of scan b, in the world."""
    clouds = []
    for frame, pose in ((a, pose_a), (b, pose_b)):
        keep = np.isin(frame.labels & 0xFFFF, STATIC_CLASSES)
        keep &= np.linalg.norm(frame.points[:, :3], axis=1) < reach
        clouds.append(in_world(frame, pose)[keep])
    return np.median(cKDTree(clouds[1]).query(clouds[0])[0])


def test_static_points_stay_where_they_are():
    drive = simulate(
        21, 6, street="urban", ego="cruise", movers=0, scan_motion="off", pose_noise=0, imperfections=False,
        sensor_variation=False,
    )  # fmt: skip
    a, b = drive[0], drive[5]
    np.testing.assert_array_equal(a.pose, a.true_pose)
    moved = np.linalg.norm(b.pose[:3, 3] - a.pose[:3, 3])
    assert moved > 1.0
    assert nearest(a, b, a.pose, b.pose) < 0.08
    assert nearest(a, b, a.pose, a.pose) > 0.1  # the measure would notice


def test_a_standing_sensor_sees_the_same_twice():
    drive = simulate(22, 4, ego="standing", movers=0, pose_noise=0, imperfections=False, sensor_variation=False)
    a, b = drive[0], drive[3]
    np.testing.assert_allclose(a.pose, b.pose, atol=1e-9)
    assert nearest(a, b, a.pose, b.pose) < 0.06


def test_motion_within_the_sweep_distorts_raw_scans_and_compensation_removes_it():
    far = {}
    for motion in ("on", "compensated"):
        drive = simulate(23, 8, street="urban", ego="turning", movers=0, scan_motion=motion, pose_noise=0)
        a, b = drive[2], drive[6]
        far[motion] = nearest(a, b, a.pose, b.pose)
    assert far["compensated"] < far["on"]
    assert far["compensated"] < 0.12


def test_odometry_errs_a_little():
    drive = simulate(9, 10, pose_noise=1.0)
    errors = [np.linalg.inv(t) @ p for t, p in zip(drive.true_poses, drive.poses, strict=True)]
    steps = np.array([np.linalg.norm((np.linalg.inv(a) @ b)[:3, 3]) for a, b in pairwise(errors)])
    assert 1e-4 < steps.mean() < 0.1
    assert not np.allclose(drive.poses[3], drive.true_poses[3])


def test_origin_point_ends_the_scan():
    frame = simulate(2, 1, origin_point=True)[0]
    np.testing.assert_array_equal(frame.points[-1], 0)
    assert frame.labels[-1] == 0
    assert (np.linalg.norm(frame.points[:-1, :3], axis=1) > 0).all()


def test_returned_arrays_are_the_callers_own():
    drive = simulate(6, 2)
    frame = drive[0]
    kept = frame.points.copy(), frame.pose.copy()
    frame.points[:], frame.pose[:] = 0, 0
    again = drive[0]
    np.testing.assert_array_equal(again.points, kept[0])
    np.testing.assert_array_equal(again.pose, kept[1])


@pytest.mark.parametrize(
    ("arguments", "settings"),
    [
        ((0, 0), {}),
        ((-1, 3), {}),
        ((0, 2.5), {}),
        ((0, 3, "lidar"), {}),
        ((0, 3), {"street": "moon"}),
        ((0, 3), {"ego": "flying"}),
        ((0, 3), {"scan_motion": "yes"}),
        ((0, 3), {"movers": -1}),
        ((0, 3), {"pose_noise": float("nan")}),
        ((0, 3), {"traffic": 3}),
        ((0, 3), {"weather": "hail"}),
        ((0, 3), {"version": 3}),
    ],
)
def test_bad_settings_raise(arguments, settings):
    with pytest.raises(SettingError):
        simulate(*arguments, **settings)


def test_the_simulator_needs_no_torch():
    code = "import sys, mos_model.simulator; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

"""Augmentation must treat a scan and the scans before it alike."""

import numpy as np
import pytest

from mos_model.data.augment import NONE, PAPER, SIM2REAL, Augmentation, augment, rotation
from runtime.errors import SettingError

ALWAYS = Augmentation(share=1, chance=1, drop=0)


def drive(count: int = 9, points: int = 500) -> tuple:
    """A world at rest in `count` scans of a moving sensor: current scan, labels, past scans, T_cur_past."""
    rng = np.random.default_rng(4)
    world = np.concatenate([rng.uniform(-30, 30, (points, 3)), np.ones((points, 1))], axis=1)
    poses = [np.eye(4) for _ in range(count)]
    for i, pose in enumerate(poses):
        pose[:3, :3] = rotation(0.01 * i, -0.02, 0.05 * i)
        pose[:3, 3] = [1.5 * i, 0.1 * i, 0.02]
    scans = []
    for pose in poses:
        scan = (world @ np.linalg.inv(pose).T).astype(np.float32)
        scan[:, 3] = np.arange(points) / points  # remission says which point it is
        scan.setflags(write=False)
        scans.append(scan)
    scans.reverse()
    poses.reverse()
    relative = [np.linalg.inv(poses[0]) @ pose for pose in poses[1:]]
    labels = (np.arange(points) % 3).astype(np.uint8)
    labels.setflags(write=False)
    return scans[0], labels, scans[1:], relative


def seen_now(result, lag: int) -> np.ndarray:
    """Points of the scan `lag` steps back in the frame of the current one, as the input builder has them."""
    scan, pose = result.past[lag - 1], result.relative[lag - 1]
    return scan[:, :3] @ pose[:3, :3].T + pose[:3, 3]


def test_nothing_happens_without_augmentation():
    scan, labels, past, relative = drive()
    result = augment(scan, labels, past, relative, NONE, np.random.default_rng(0))
    assert np.array_equal(result.points, scan)
    assert result.labels is labels
    assert all(a is b for a, b in zip(result.past, past, strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(result.relative, relative, strict=True))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("settings", [ALWAYS, Augmentation(share=1, chance=1, drop=0, yaw=180, tilt=2, lift=0.5)])
def test_static_world_stays_static(settings, seed):
    scan, labels, past, relative = drive()
    result = augment(scan, labels, past, relative, settings, np.random.default_rng(seed))
    assert not np.allclose(result.points[:, :3], scan[:, :3], atol=0.1)
    for lag in range(1, 9):
        assert seen_now(result, lag) == pytest.approx(result.points[:, :3], abs=2e-4)


def test_published_augmentation_is_a_shift_and_a_mirror():
    scan, labels, past, relative = drive()
    flips = 0
    for seed in range(40):
        result = augment(scan, labels, past, relative, Augmentation(share=1, drop=0), np.random.default_rng(seed))
        mirrored = (result.points[1, 1] - result.points[0, 1]) * (scan[1, 1] - scan[0, 1]) < 0
        flips += mirrored
        moved = result.points[:, :3] - scan[:, :3] * ([1, -1, 1] if mirrored else [1, 1, 1])
        shift = moved.mean(axis=0)
        assert np.ptp(moved, axis=0).max() < 1e-4
        assert (np.abs(shift[:2]) <= [5.0001, 3.0001]).all()
        assert -1.0001 <= shift[2] <= 1e-4
    assert 8 <= flips <= 32


def test_half_of_the_samples_stay_as_they_are():
    scan, labels, past, relative = drive(2)
    same = 0
    for seed in range(200):
        result = augment(scan, labels, past, relative, PAPER, np.random.default_rng(seed))
        same += np.array_equal(result.points, scan)
    assert 90 <= same <= 150  # 1/2 of them, and 1/2 * 1/8 where none of the three parts is drawn


def test_dropping_thins_all_scans_alike_and_keeps_labels_with_points():
    scan, labels, past, relative = drive(points=20_000)
    settings = Augmentation(share=1, chance=1, shift=(0, 0), lower=0, flip=False)
    result = augment(scan, labels, past, relative, settings, np.random.default_rng(1))
    kept = len(result.points) / len(scan)
    assert 0.5 <= kept < 1
    for thinned in result.past:
        assert len(thinned) / len(scan) == pytest.approx(kept, abs=0.02)
    which = np.round(result.points[:, 3] * 20_000).astype(int)
    assert np.array_equal(result.labels, which % 3)


def test_missing_rows():
    scan, labels, past, relative = drive(points=20_000)
    settings = Augmentation(share=0, row_chance=1, row_share=0.5)
    result = augment(scan, labels, past, relative, settings, np.random.default_rng(1))
    assert 0.4 < len(result.points) / len(scan) < 1
    which = np.round(result.points[:, 3] * 20_000).astype(int)
    assert np.array_equal(result.labels, which % 3)
    bands = [np.floor(elevation(points) / 0.25) for points in (result.points, scan)]
    now, before = (len(set(band[np.abs(band) < 120])) for band in bands)
    assert now < 0.95 * before  # whole bands are gone, none is thinned


def elevation(points: np.ndarray) -> np.ndarray:
    """Degrees above the horizon."""
    return np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))


def test_remission():
    scan, labels, past, relative = drive()
    off = augment(scan, labels, past, relative, Augmentation(share=0, remission_off=1), np.random.default_rng(0))
    assert not off.points[:, 3].any()
    assert np.array_equal(off.points[:, :3], scan[:, :3])
    changed = augment(scan, labels, past, relative, Augmentation(share=0, remission_gain=0.5), np.random.default_rng(0))
    assert not np.allclose(changed.points[:, 3], scan[:, 3], atol=1e-3)
    assert changed.points[:, 3].min() >= 0
    assert changed.points[:, 3].max() <= 1
    assert (np.diff(changed.points[:, 3]) >= 0).all()  # the order of the remissions stays


def test_history_ends_early():
    scan, labels, past, relative = drive()
    lengths = set()
    for seed in range(30):
        settings = Augmentation(share=0, history_chance=1)
        result = augment(scan, labels, past, relative, settings, np.random.default_rng(seed))
        there = [scan is not None for scan in result.past]
        assert there == sorted(there, reverse=True)
        lengths.add(sum(there))
    assert lengths == set(range(8))


def test_pose_errors_add_up_over_the_past():
    scan, labels, past, relative = drive()
    settings = Augmentation(share=0, pose_shift=0.05, pose_turn=0.1)
    errors = []
    for seed in range(50):
        result = augment(scan, labels, past, relative, settings, np.random.default_rng(seed))
        errors.append(
            [
                np.linalg.norm((now @ np.linalg.inv(before))[:3, 3])
                for now, before in zip(result.relative, relative, strict=True)
            ]
        )
    mean = np.mean(errors, axis=0)
    assert 0.04 < mean[0] < 0.13
    assert mean[7] > 2 * mean[0]


def test_past_without_a_scan_stays_without():
    scan, labels, past, relative = drive()
    past[3] = relative[3] = None
    result = augment(scan, labels, past, relative, SIM2REAL, np.random.default_rng(2))
    assert result.past[3] is None
    assert result.relative[3] is None


def test_same_generator_same_sample():
    case = drive()
    first = augment(*case, SIM2REAL, np.random.default_rng(7))
    again = augment(*case, SIM2REAL, np.random.default_rng(7))
    assert np.array_equal(first.points, again.points)
    assert all(np.array_equal(a, b) for a, b in zip(first.relative, again.relative, strict=True))


@pytest.mark.parametrize("change", [{"share": 1.5}, {"drop": -0.1}, {"yaw": -1}, {"history_chance": 2}])
def test_settings_out_of_range(change):
    with pytest.raises(SettingError, match=next(iter(change))):
        Augmentation(**change)

"""How sensors are carried in version 2."""

import numpy as np
import pytest

from mos_model.simulator import SimulationSettings, simulate
from mos_model.simulator.mounting import draw_mounting
from runtime.sensors.registry import find_sensor

CAR = find_sensor("vlp16")


def test_what_carries_a_sensor_varies():
    drawn = [draw_mounting(seed, SimulationSettings(version=2), CAR) for seed in range(2000)]
    heights = np.array([mounting.height for mounting in drawn])
    assert heights.min() > 0.35
    assert heights.max() < 2.8
    usual = np.abs(heights - CAR.mount_height - 0.05) < 0.35
    np.testing.assert_allclose([np.mean(heights < 0.9), np.mean(heights > 2.2)], [0.2, 0.1], atol=0.03)
    assert 0.5 < usual.mean() < 0.66
    assert all(mounting.robot == (mounting.height < 1.5) or usual[k] for k, mounting in enumerate(drawn))
    assert 0.2 < np.mean([mounting.pitch is not None for mounting in drawn]) < 0.3
    assert max(abs(np.degrees(mounting.pitch or 0)) for mounting in drawn) < 7
    np.testing.assert_allclose(
        [np.mean([m.rate == r for m in drawn]) for r in (0.5, 1, 2)], [0.15, 0.7, 0.15], atol=0.03
    )


def test_version_1_has_cars_alone():
    drawn = [draw_mounting(seed, SimulationSettings(), CAR) for seed in range(20)]
    assert all(mounting == type(mounting)() for mounting in drawn)


def test_what_is_fixed_stays_fixed():
    drive = simulate(5, 3, "vlp16", version=2, mount_height=0.5, pitch=5.0, rate=20.0, street="urban")
    assert drive.profile.azimuth_steps == 900
    assert drive.times[1] == 1 / 20
    assert drive.scanner.rig.mount[0] == 0.5
    steps = np.linalg.norm(np.diff([pose[:3, 3] for pose in drive.true_poses], axis=0), axis=1)
    assert steps.max() * 20 < 1.6  # a robot goes at walking pace
    points, labels = drive[0].points, drive[0].labels & 0xFFFF
    ground = points[np.isin(labels, (40, 48)) & (np.hypot(points[:, 0], points[:, 1]) < 3)]
    assert len(ground) > 100
    normal = np.linalg.svd(ground[:, :3] - ground[:, :3].mean(axis=0), full_matrices=False)[2][2]
    offset = abs(ground[:, :3].mean(axis=0) @ normal)
    assert 0.3 < offset < 0.7
    assert np.hypot(ground[:, 0], ground[:, 1]).min() < 1.5  # seen from close by


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
def test_a_turn_that_takes_longer_has_more_firings(rate):
    drives = [simulate(seed, 2, "vlp16", version=2, rate=rate) for seed in range(8)]
    firings = {drive.profile.azimuth_steps * drive.profile.rate for drive in drives}
    assert max(firings) == 18000
    assert min(firings) == (9000 if rate == 5 else 18000)


def test_a_turned_sensor_sees_the_same_world():
    """Yaw, pitch and roll of the mount are in the poses: the ground is level in the world."""
    turned = [seed for seed in range(40) if simulate(seed, 1, "vlp16", version=2).scanner.rig.mount[3]]
    assert 3 < len(turned) < 16
    for seed in turned[:3]:
        drive = simulate(seed, 2, "vlp16", version=2, movers=0, scan_motion="off")
        frame = drive[1]
        world = frame.points[:, :3] @ frame.true_pose[:3, :3].T + frame.true_pose[:3, 3]
        ground = np.isin(frame.labels & 0xFFFF, (40, 48, 49))
        height = drive.world.terrain.heights_at(*world[ground, :2].T.astype(float))
        assert np.median(np.abs(world[ground, 2] - height)) < 0.1

"""The carrier of the sensor in its own view."""

import math
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mos_model.simulator import SimulationSettings, rays, shapes, simulate
from mos_model.simulator.carrier import draw_body, look
from mos_model.simulator.mounting import Mounting, draw_mounting
from mos_model.simulator.rig import draw_rig
from runtime.sensors.registry import find_sensor
from tests.support.reference_simulator import first_hits

THIN = replace(find_sensor("vlp16"), azimuth_steps=180)
BODY = 99


@pytest.mark.parametrize("yaw", [0.0, 1.1])
def test_what_is_in_view_is_where_a_march_finds_it(yaw):
    rig = draw_rig(Random(1), THIN, False, Mounting(yaw=yaw))
    shape = [
        shapes.box(-0.2, 1.4, 0.6, -0.6, -0.1, at=(0.9, 0.1, 0.0)),
        shapes.capsule((-0.6, 0.3, -0.6), (-0.6, 0.5, 0.4), 0.08),
        shapes.ellipsoid((-0.1, -1.0, 0.0), (0.2, 0.3, 0.4), at=(0.0, 0.0, 0.1), yaw=0.4),
    ]
    depth, cosine = look(shape, rig, 3)
    directions = rays.local_rays(rays.firing_ticks(180, 0, 0.5), rig.elevation, rig.offset).reshape(-1, 3).astype(float)
    c, s = math.cos(yaw), math.sin(yaw)
    directions = directions @ np.array(((c, -s, 0), (s, c, 0), (0, 0, 1))).T  # to the directions of the carrier
    expected = first_hits(shapes.array(shape), np.zeros_like(directions), directions, 3.0).reshape(depth.shape)
    assert (np.isinf(depth) != np.isinf(expected)).mean() < 0.01
    both = np.isfinite(depth) & np.isfinite(expected)
    assert both.mean() > 0.1
    assert np.quantile(np.abs(depth[both] - expected[both]), 0.97) < 0.01
    assert (cosine[both] > 0).all()


def test_it_travels_along_and_hides_what_is_behind():
    fixed = {"ego": "cruise", "scan_motion": "off", "imperfections": False, "weather": "clear", "movers": 0}
    drive = simulate(4, 6, "os1-64", body=True, **fixed)
    a, b = drive[0], drive[5]
    assert np.linalg.norm(b.true_pose[:3, 3] - a.true_pose[:3, 3]) > 1.0
    own = [frame.points[frame.labels == BODY, :3] for frame in (a, b)]
    assert len(own[0]) > 200
    assert np.quantile(cKDTree(own[1]).query(own[0])[0], 0.95) < 0.03
    assert min(np.linalg.norm(points, axis=1).min() for points in own) >= drive.scanner.rig.nearest
    free = simulate(4, 6, "os1-64", body=False, **fixed)[0]
    assert (free.labels != BODY).all()
    returned = np.isfinite(drive.scanner.rig.body).sum()
    assert len(free.points) - returned <= (a.labels != BODY).sum() < len(free.points)


def in_view(seed, **settings):
    chosen = SimulationSettings(**settings)
    mounting = draw_mounting(seed, chosen, THIN)
    return draw_body(seed, chosen, draw_rig(Random(seed), THIN, True, mounting)).body_cosine is not None


def test_a_third_of_version_2_sees_its_carrier():
    assert not any(in_view(seed) for seed in range(20))
    assert not any(in_view(seed, version=2, body=False) for seed in range(20))
    assert 0.25 < np.mean([in_view(seed, version=2) for seed in range(250)]) < 0.45
    assert np.mean([in_view(seed, version=2, body=True) for seed in range(60)]) > 0.9

import math
from random import Random

import numpy as np
import pytest

from mos_model.simulator import ground, people, placing, raycast, rays, shapes
from mos_model.simulator.boxes import bounds
from tests.support.reference_simulator import first_hits

COLUMNS, BEAMS = 160, 10


def sweep(states, drop=0.0):
    """Rays of a small sensor that moves as `states` (3, 6) say."""
    azimuth = rays.firing_ticks(COLUMNS, 0, 0.3)
    elevation = np.radians(np.linspace(12, -25, BEAMS))
    local = rays.local_rays(azimuth, elevation, np.radians(np.linspace(-0.2, 0.2, BEAMS)))
    world, slope = np.empty((COLUMNS, BEAMS, 3), np.float32), np.empty((COLUMNS, BEAMS), np.float32)
    origin, level, phase = np.empty((COLUMNS, 3)), np.empty((COLUMNS, 3)), np.empty(COLUMNS)
    rays.world_rays(local, azimuth, states, world, slope, origin, level, phase)
    return world, slope, origin, level, phase, np.full(BEAMS, drop), np.tan(elevation)


def states(speed=0.0, turn=0.0, tilt=0.0):
    return np.array([(3 + k * speed, 4.0, 1.7, 0.8 + k * turn, tilt, -tilt) for k in (-0.5, 0.0, 0.5)])


def cast(prims, velocity, moves, world, slope, origin, level, phase, drop, tangents):
    depth = np.full((COLUMNS, BEAMS), np.inf, np.float32)
    hit, cosine = np.full(depth.shape, -1, np.int32), np.zeros(depth.shape, np.float32)
    boxes = bounds(prims)
    order = np.argsort(placing.distances(prims, boxes, moves[1, 0], moves[1, 1]))
    raycast.cast_primitives(
        prims, boxes, order, velocity, world, slope, origin, level, phase, drop, tangents, moves, 0.1, 5, depth, hit,
        cosine,
    )  # fmt: skip
    return depth, hit, cosine


def scene(seed):
    """Solid primitives of every kind around the sensor, none of them near it."""
    rng = Random(seed)
    rows = []
    for k in range(14):
        angle, away = rng.uniform(0, 6.28), rng.uniform(4.0, 12.0)
        at, yaw = (
            (3 + away * math.cos(angle), 4 + away * math.sin(angle), rng.uniform(-0.5, 1.5)),
            rng.uniform(0, 6.28),
        )
        place = {"at": at, "yaw": yaw}
        row = (
            shapes.frustum(0, 1.5, -1.5, 1.4, -0.8, 0.9, 0.8, 0.4, **place),
            shapes.ellipsoid((0.2, 0.1, 0.5), (1.2, 0.5, 0.8), **place),
            shapes.capsule((0, 0, 0), (0.6, 0.4, 2.0), 0.3, **place),
        )[k % 3]
        row[15] = k
        rows.append(row)
    return shapes.array(rows)


@pytest.mark.parametrize(("seed", "speed", "turn", "tilt"), [(0, 0, 0, 0), (1, 2.0, 0, 0.03), (2, 1.0, 0.08, -0.05)])
def test_hits_are_those_of_a_march_along_every_ray(seed, speed, turn, tilt):
    prims, moves = scene(seed), states(speed, turn, tilt)
    rig = sweep(moves, drop=-0.1)
    depth, hit, _ = cast(prims, np.zeros((len(prims), 2)), moves, *rig)
    origins = np.repeat(rig[2][:, None], BEAMS, 1) + np.array((0, 0, 0.1))
    expected = first_hits(prims, origins.reshape(-1, 3), rig[0].reshape(-1, 3).astype(float), 16.0)
    expected = expected.reshape(depth.shape)
    missed = np.isinf(depth) != np.isinf(expected)
    assert missed.mean() < 0.004  # rays that graze a surface
    both = np.isfinite(depth) & np.isfinite(expected)
    assert both.sum() > 150
    assert np.quantile(np.abs(depth[both] - expected[both]), 0.97) < 0.01
    assert (hit[both] >= 0).all()


def test_a_mover_is_seen_where_it_is_when_the_ray_passes():
    moves = states(1.5, 0.0, 0.02)
    rig = sweep(moves)
    prims, velocity = scene(3)[:1], np.array([[8.0, -5.0]])
    depth, _, _ = cast(prims, velocity, moves, *rig)
    found = np.argwhere(np.isfinite(depth))
    assert len(found) > 10
    for c, b in found[::7]:
        row = prims[0].copy()
        row[1:3] += velocity[0] * 0.1 * rig[4][c]
        expected = first_hits(row[None], rig[2][c : c + 1], rig[0][c, b][None].astype(float), 16.0)
        assert expected[0] == pytest.approx(depth[c, b], abs=0.01)


def test_cosine_of_incidence_on_a_wall():
    moves = states()
    rig = sweep(moves)
    wall = shapes.array([shapes.box(-0.2, 0.2, 30, -5, 10, at=(13.0, 4.0, 0.0))])
    depth, hit, cosine = cast(wall, np.zeros((1, 2)), moves, *rig)
    seen = (hit >= 0) & np.isfinite(depth)
    assert seen.sum() > 150
    np.testing.assert_allclose(cosine[seen], rig[0][..., 0][seen], atol=1e-5)


def test_ground_is_where_a_plane_says():
    moves = states(1.0, 0.05, 0.03)
    world, slope, origin, level, _, drop, _ = sweep(moves)
    x, y = np.meshgrid(np.arange(0, 120, 0.25) - 60, np.arange(0, 120, 0.25) - 60)
    height = (0.03 * x - 0.02 * y + 0.1).astype(np.float32)
    surface = np.zeros(height.shape, np.uint8)
    depth, hit = np.empty((COLUMNS, BEAMS), np.float32), np.empty((COLUMNS, BEAMS), np.int32)
    radii = 1.6 * 1.035 ** np.arange(95)
    ground.cast_ground(
        world, slope, origin, level, drop, height, surface, -60.0, -60.0, 0.25, float(height.max()), radii, np.zeros(5),
        3, depth, hit,
    )  # fmt: skip
    normal = np.array((-0.03, 0.02, 1.0))
    expected = ((0.1 - origin @ normal)[:, None] / (world.astype(float) @ normal)).astype(np.float32)
    near = (expected > 2.0) & (expected < 35.0)
    assert near.sum() > 400
    np.testing.assert_allclose(depth[near], expected[near], rtol=2e-3)
    assert (hit[near] == -2).all()
    assert np.isinf(depth[expected < 0]).all()


def test_limbs_swing_as_the_person_walks():
    person = shapes.array(people.person(Random(1), True)[0])
    out = np.empty((2, *person.shape))
    for k, walked in enumerate((0.2, 0.6)):
        placing.place(person, np.array((1.0, 2.0, 0.0, 0.5)), walked, 1.0, out[k], 0)
    limbs = person[:, 19] != 0
    assert limbs.sum() == 4
    assert (np.abs(out[0, limbs, 9] - out[1, limbs, 9]) > 0.01).all()
    np.testing.assert_array_equal(out[0, ~limbs], out[1, ~limbs])
    length = np.linalg.norm(out[:, limbs, 9:12] - out[:, limbs, 6:9], axis=2)
    np.testing.assert_allclose(length[0], length[1], rtol=1e-9)


def test_leaves_stay_where_they_are_but_let_some_rays_through():
    moves = states()
    rig = sweep(moves)
    crown = shapes.ellipsoid((0, 0, 1.5), (2, 2, 2), raycast.FOLIAGE, at=(9.0, 4.0, 0.0), p=(1.5, 0.4, 0.5))
    depth, _, _ = cast(shapes.array([crown]), np.zeros((1, 2)), moves, *rig)
    solid = shapes.ellipsoid((0, 0, 1.5), (2, 2, 2), at=(9.0, 4.0, 0.0))
    whole, _, _ = cast(shapes.array([solid]), np.zeros((1, 2)), moves, *rig)
    inside = np.isfinite(whole)
    passed = np.isinf(depth[inside]).mean()
    assert 0.1 < passed < 0.9
    assert np.isinf(depth[~inside]).all()
    hits = np.isfinite(depth)
    assert (depth[hits] >= whole[hits] - 1e-4).all()

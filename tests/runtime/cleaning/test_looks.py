"""What rays went through, against trigonometry of each pair of a place and a return."""

import math

import numpy as np
import pytest

from runtime.belief.free_space import ASIDE, PER_METRE
from runtime.cleaning import looks
from runtime.cleaning.looks import CELL, COLUMN, FREE, WINDOW, Looks
from runtime.cleaning.voxel_votes import MovingVoxels

HERE = np.eye(4)


def voxels(places, last=None):
    places = np.array(places, float)
    last = np.ones(len(places), np.int32) if last is None else np.array(last, np.int32)
    return MovingVoxels(np.arange(len(places)), places, last, 0.1)


def cell(point):
    """Row and column of directions, and range."""
    x, y, z = map(float, point)
    r = math.sqrt(x * x + y * y + z * z)
    return int((math.asin(z / r) + math.pi / 2) / CELL), int((math.atan2(y, x) + math.pi) / CELL) % 900, r


def naive(place, points):
    """Whether a ray went through a place, and whether one ended there."""
    row, column, r = cell(place)
    near = ASIDE + PER_METRE * r
    ranges = [
        found[2]
        for found in map(cell, points)
        if abs(found[0] - row) <= 1 and (found[1] - column + 1) % 900 <= 2 and found[2] >= 0.5
    ]
    nearest = min(ranges, default=math.inf)
    return r + near < nearest < math.inf, abs(nearest - r) <= near


def test_rays_that_went_through_and_rays_that_ended():
    rng = np.random.default_rng(0)
    points = (rng.normal(0, 1, (6000, 3)) * rng.uniform(1, 20, (6000, 1))).astype(np.float32)
    seen = np.concatenate([rng.normal(0, 6, (300, 3)), points[:100]])  # places, as the LiDAR sees them
    turned = np.array([[0, -1, 0, 2], [1, 0, 0, -1], [0, 0, 1, 0.5], [0, 0, 0, 1]], float)
    found = Looks(voxels((seen - turned[:3, 3]) @ turned[:3, :3]))
    found.add(np.concatenate([points, np.float32([[np.nan, 0, 0], [np.inf, 1, 1], [0, 0, 0]])]), turned)
    wanted = np.array([naive(place, points) for place in seen])
    assert wanted.sum(0).min() > 20
    np.testing.assert_array_equal(np.stack([found.through, found.ended], 1), wanted)


def wall(x):
    """Returns of a wall across the x axis."""
    y, z = np.meshgrid(np.linspace(-4, 4, 400), np.linspace(-1, 2, 150))
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], 1).astype(np.float32)


@pytest.mark.parametrize(("went", "free"), [(0, False), (1, False), (3, False), (4, True), (10, True)])
def test_a_column_is_free_where_enough_rays_went_through(went, free):
    found = Looks(voxels([[10.1, 0, 0], [10.1, 0, 0.5]]))
    for scan in range(10):
        found.add(wall(20 if scan < went else 10), HERE)
    assert 0.3 < FREE <= 0.4
    assert found.free(area=0).tolist() == [free, free]


def test_a_voxel_that_nothing_went_through_stands_still():
    """The ground, say, below something that moves."""
    found = Looks(voxels([[10.1, 0, 0], [10.1, 0, 9]]))
    found.add(wall(20), HERE)
    assert found.through.tolist() == [1, 0]
    assert found.free(area=0).tolist() == [True, False]


def test_scans_long_before_or_after_do_not_count(monkeypatch):
    monkeypatch.setattr(looks, "WINDOW", 3)
    found = Looks(voxels([[10.1, 0, 0]] * 3, [2, 5, 20]))
    for _ in range(20):
        found.add(wall(20), HERE)
    assert found.through.tolist() == [5, 7, 4]
    assert WINDOW > 3


def test_few_voxels_alone_are_no_mover():
    rng = np.random.default_rng(1)
    places = np.concatenate([rng.normal((15, 0, 0), 4, (200, 3)), [[15, -20, 0], [15, 20, 0]]])
    found = Looks(voxels(places))
    found.through[:], found.ended[::3] = 1, 1
    assert not found.free()[200:].any()
    column = np.floor(places[:, :2] / COLUMN)
    free = found.free(area=0)
    for fewest in (3, 8):
        beside = (np.abs(column[:, None] - column[None]).max(2) <= 1) @ free.astype(int)
        np.testing.assert_array_equal(found.free(area=fewest * 0.01), free & (beside >= fewest))
    assert Looks(voxels(np.empty((0, 3)))).free().shape == (0,)

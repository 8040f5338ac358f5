"""The table of votes, against dictionaries."""

from collections import defaultdict

import numpy as np
import pytest

from runtime.cleaning import voxel_votes
from runtime.cleaning.voxel_votes import VoxelVotes
from runtime.errors import SettingError

SIZE = 0.2


def scans(count=6, points=3000, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield rng.normal(0, 3, (points, 3)), rng.random(points).astype(np.float32), rng.random(points) < 0.3


class Naive:
    """The same with dictionaries."""

    def __init__(self):
        self.seen, self.moved, self.points = defaultdict(int), defaultdict(int), defaultdict(list)

    def add(self, points, remission, moving):
        voxels = [tuple(voxel) for voxel in np.floor(points / SIZE).astype(int)]
        for voxel in set(voxels):
            self.seen[voxel] += 1
        for voxel in {one for one, moves in zip(voxels, moving, strict=True) if moves}:
            self.moved[voxel] += 1
        for voxel, point, value in zip(voxels, points, remission, strict=True):
            self.points[voxel].append([*point, value])

    def moves(self, voxel):
        return 2 * self.moved[voxel] > self.seen[voxel]


@pytest.fixture
def both(monkeypatch):
    monkeypatch.setattr(voxel_votes, "FIRST_ROWS", 64)  # so that it must grow
    votes, naive = VoxelVotes(SIZE), Naive()
    for scan in scans():
        votes.add(*scan)
        naive.add(*scan)
    return votes, naive


def test_voxels_move_that_most_scans_saw_move(both):
    votes, naive = both
    assert len(votes) == len(naive.seen)
    for points, _, _ in scans():
        voxels = [tuple(voxel) for voxel in np.floor(points / SIZE).astype(int)]
        np.testing.assert_array_equal(votes.moves(points), [naive.moves(voxel) for voxel in voxels])
    assert not votes.moves(np.full((1, 3), 900.0)).any()  # where nobody saw anything


def check_map(votes, naive):
    found = votes.static_map()
    wanted = {voxel: points for voxel, points in naive.points.items() if not naive.moves(voxel)}
    assert len(found.points) == len(wanted)
    for point, remission, seen in zip(found.points, found.remission, found.scans, strict=True):
        voxel = tuple(np.floor(point.astype(float) / SIZE).astype(int))
        assert seen == naive.seen[voxel]
        np.testing.assert_allclose([*point, remission], np.mean(wanted[voxel], axis=0), atol=1e-4)


def test_the_map_has_the_mean_of_each_voxel_that_does_not_move(both):
    votes, naive = both
    check_map(votes, naive)
    moving = votes.moving()
    assert (np.diff(moving.last) >= 0).all()
    voxels = [tuple(voxel) for voxel in np.floor(moving.places / SIZE).astype(int)]
    assert set(voxels) == {voxel for voxel in naive.seen if naive.moves(voxel)}
    votes.take_back(moving.rows[::2])
    for voxel in voxels[::2]:
        naive.moved[voxel] = 0
    check_map(votes, naive)
    assert len(votes.moving().rows) == len(moving.rows) // 2


def test_what_is_nowhere_has_no_vote():
    votes = VoxelVotes(SIZE)
    nowhere = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, -1e9, 0]])
    votes.add(nowhere, np.zeros(3, np.float32), np.ones(3, bool))
    votes.add(np.empty((0, 3)), np.empty(0, np.float32), np.empty(0, bool))
    assert len(votes) == 0
    assert not votes.moves(nowhere).any()
    assert len(votes.static_map().points) == len(votes.moving().rows) == 0


@pytest.mark.parametrize("size", [0, -1, float("nan"), 0.001])
def test_voxels_have_a_size(size):
    with pytest.raises(SettingError, match="`voxel` must be at least"):
        VoxelVotes(size)

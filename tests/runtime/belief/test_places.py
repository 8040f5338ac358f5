"""The places of a scan against dictionaries."""

import numpy as np
import pytest

from runtime.belief.places import Surveyor
from runtime.compute.workers import Workers
from runtime.image.entry import Entry
from tests.support import reference_belief as reference
from tests.support.sights import sight_of

SIZE = 0.25


def turned(angle=0.0, x=0.0, y=0.0, z=0.0):
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = x, y, z
    return pose


def check(points, pose=None, probability=None, threads=2, surveyor=None):
    """Compare with the reference, voxel by voxel; what was found, copied."""
    pose = np.eye(4) if pose is None else pose
    points = np.asarray(points, np.float32).reshape(-1, 3)
    if probability is None:
        probability = np.random.default_rng(len(points)).uniform(0, 1, len(points)).astype(np.float32)
    workers = Workers(threads)
    scan = Entry(0.2, 300.0, workers).enter(points)
    got = (surveyor or Surveyor(SIZE, workers)).survey(sight_of(scan, pose), scan.takes_part, probability)
    cells, evidence = reference.places(points, scan.takes_part, pose, probability, SIZE)
    assert len(got.keys) == len(evidence)
    assert len(set(got.keys.tolist())) == len(evidence)
    names = {}
    for i, cell in enumerate(cells):
        assert (got.place[i] < 0) == (cell is None)
        if cell is not None:
            assert names.setdefault(int(got.place[i]), cell) == cell
            assert got.log_odds[i] == pytest.approx(reference.log_odds(float(probability[i])), abs=2e-5)
    assert sorted(names) == list(range(len(evidence)))
    for place, cell in names.items():
        assert got.evidence[place] == pytest.approx(evidence[cell], abs=2e-5)
    return {cell: int(got.keys[place]) for place, cell in names.items()}


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("seed", range(3))
def test_like_the_reference(seed, threads):
    points = np.random.default_rng(seed).uniform(-8, 8, (2500, 3))
    check(points, turned(0.3 + seed, 3.1, -7.7, 0.4), threads=threads)


def test_several_tasks():
    """More points than one task takes."""
    check(np.random.default_rng(1).uniform(-2, 2, (40_000, 3)))


def test_one_point_and_none():
    assert list(check([[-0.1, 0.1, -5.3]])) == [(-1, 0, -22)]
    assert check(np.empty((0, 3))) == {}


def test_points_that_take_no_part_have_no_place():
    points = [[1, 2, 3], [np.nan, 1, 1], [0, 0, 0], [np.inf, 1, 1], [1, 2, 3], [3e5, 0, 0]]
    probability = np.array([0.9, 0.5, 0.0, 0.0, 0.1, np.nan], np.float32)
    assert list(check(points, probability=probability)) == [(4, 8, 12)]
    assert check(points[1:4], probability=np.zeros(3, np.float32)) == {}


def test_a_point_on_an_edge_is_in_the_voxel_that_begins_there():
    assert list(check([[0.25, -0.25, 0.5]])) == [(1, -1, 2)]
    assert list(check([[np.nextafter(np.float32(0.25), np.float32(0)), 0, -0.0]])) == [(0, 0, 0)]


def test_probabilities_at_their_ends_are_finite():
    check([[1, 1, 1], [2, 2, 2], [3, 3, 3], [4, 4, 4]], probability=np.array([0, 1, 1e-38, 0.9999999], np.float32))


def test_a_place_has_the_same_key_from_everywhere():
    """Also at map coordinates of 5e6 m; the pose is exact there, so that no point changes its voxel."""
    points = np.random.default_rng(5).uniform(-6, 6, (400, 3)).astype(np.float32)
    far = turned(0.0, 5e6, -4e6, 300.0)
    first = check(points, far)
    away = turned(0.0, 5e6 + 2.5, -4e6 - 1.25, 300.0)
    moved = np.float32(points.astype(np.float64) - (2.5, -1.25, 0))
    second = check(moved, away)
    shared = set(first) & set(second)
    assert len(shared) > 0.95 * len(first)  # rounding to float32 moves some over an edge
    assert all(first[cell] == second[cell] for cell in shared)
    assert len(set(first.values())) == len(first)


def test_buffers_are_reused_and_forget():
    surveyor = Surveyor(SIZE, Workers(1))
    rng = np.random.default_rng(2)
    for count in (3000, 10, 0, 500, 3000):
        check(rng.uniform(-9, 9, (count, 3)), surveyor=surveyor)
    held = surveyor.nbytes
    for _ in range(5):
        check(rng.uniform(-9, 9, (3000, 3)), surveyor=surveyor)
    assert surveyor.nbytes == held

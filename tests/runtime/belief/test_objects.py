"""Points of one object agree, against sets and sorted lists."""

import numpy as np
import pytest

from runtime.belief.objects import agree, find_objects
from runtime.belief.places import Surveyor
from runtime.compute.workers import Workers
from runtime.image.entry import Entry
from tests.support import reference_belief as reference
from tests.support.sights import sight_of

SIZE = 0.5
LEAST, DOUBTFUL = reference.log_odds(0.1), reference.log_odds(0.3)
NOTHING = np.eye(4)


def places_of(xyz, pose=NOTHING):
    scan = Entry(0.1, 300.0, Workers(1)).enter(np.asarray(xyz, np.float64))
    return Surveyor(SIZE, Workers(1)).survey(
        sight_of(scan, pose), scan.takes_part, np.full(len(scan), 0.5, np.float32)
    ), scan


def cells_of(scan, pose=NOTHING):
    probability = np.full(len(scan), 0.5)
    return reference.places(scan.points, scan.takes_part, pose, probability, SIZE)[0]


def let_agree(places, log_odds, least=LEAST):
    objects = find_objects(places, log_odds, least)
    agree(objects, np.zeros(len(objects.keys), np.float32), log_odds, DOUBTFUL)


@pytest.mark.parametrize("seed", range(6))
def test_like_the_reference(seed):
    """Many objects, touching places on both sides of the origin, points that take no part, and others in between."""
    rng = np.random.default_rng(seed)
    xyz = np.concatenate([rng.uniform(-9, 9, (400, 3)), rng.normal(0, 1, (80, 3))])
    xyz[::40] = np.nan
    pose = np.eye(4)
    pose[:3, 3] = rng.uniform(-3, 3, 3)
    log_odds = rng.normal(-2, 3, len(xyz)).astype(np.float32)
    (places, scan), got = places_of(xyz, pose), log_odds.copy()
    let_agree(places, got)
    want = reference.agreed(cells_of(scan, pose), log_odds.tolist(), LEAST, DOUBTFUL)
    np.testing.assert_array_equal(got, np.float32(want))
    assert 10 < (got != log_odds).sum() < 400


def test_far_from_the_origin_keys_wrap_around():
    """Voxels number 2^21 - 1 and 0 touch, on each axis."""
    edge = SIZE * 2**21
    xyz = np.array([(1, 1, 1), (1, 1, 1), (1, 1, 1)]) + 0.45 * np.array([(-1, -1, -1), (0, 0, 0), (1, 1, 1)])
    pose = np.eye(4)
    pose[:3, 3] = edge - 1
    log_odds = np.array([3, 1, 2], np.float32)
    let_agree(places_of(xyz, pose)[0], log_odds)
    assert log_odds.tolist() == [2, 2, 2]


def test_of_an_even_number_the_upper_median():
    log_odds = np.array([-0.5, 4, 2, 0], np.float32)
    let_agree(places_of([(3, 0.1 * i, 0) for i in range(4)])[0], log_odds)
    assert log_odds.tolist() == [2, 2, 2, 2]


def test_what_surely_stands_is_not_raised_but_has_a_say():
    log_odds = np.array([-1, -1.5, 4, -2, 5], np.float32)
    let_agree(places_of([(3, 0.1 * i, 0) for i in range(5)])[0], log_odds)
    assert log_odds.tolist() == [-1, -1.5, -1, -2, -1]


@pytest.mark.parametrize("least", [LEAST, 1.0])
def test_nothing_to_agree(least):
    for xyz, given in (([], []), ([(3, 0, 0), (3, 0.1, 0)], [-5, -9]), ([(3, 0, 0), (30, 0, 0)], [5, 1])):
        log_odds = np.array(given, np.float32)
        let_agree(places_of(np.reshape(xyz, (-1, 3)))[0], log_odds, least)
        assert log_odds.tolist() == given


def test_one_object_of_a_whole_scan():
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0.3, 6, (20_000, 3))
    log_odds = rng.normal(5, 1, len(xyz)).astype(np.float32)
    want = np.sort(log_odds)[len(log_odds) // 2]
    let_agree(places_of(xyz)[0], log_odds)
    assert set(log_odds.tolist()) == {float(want)}

"""What surely moved a moment ago, against dictionaries, and as it is meant."""

import numpy as np
import pytest

from runtime.belief.objects import find_objects
from runtime.belief.trail import NO_TRAIL, follow
from tests.runtime.belief.test_objects import LEAST, cells_of, places_of
from tests.support import reference_belief as reference

SURE, LONGEST = 2.0, 3
HIGH, LOW = 3.0, 0.0  # log-odds of what surely moves, and of what may


def followed(scans):
    """(ages of its places, those of the reference) of each scan; scans: (xyz (N, 3), log_odds (N,))."""
    trail, before = NO_TRAIL, {}
    for xyz, values in scans:
        (places, scan), log_odds = places_of(xyz), np.asarray(values, np.float32)
        objects = find_objects(places, log_odds, LEAST)
        trail, inside = follow(objects, trail, SURE, LONGEST)
        before = reference.trail(cells_of(scan), log_odds.tolist(), LEAST, before, SURE, LONGEST)
        assert set(objects.keys[inside]) == set(trail.keys)
        yield dict(zip(trail.keys.tolist(), trail.age.tolist(), strict=True)), before


@pytest.mark.parametrize("seed", range(4))
def test_like_the_reference(seed):
    rng = np.random.default_rng(seed)
    scans = [(rng.uniform(-5, 5, (150, 3)), rng.normal(-0.5, 1.5, 150)) for _ in range(9)]
    seen = set()
    for ages, wanted in followed(scans):
        assert sorted(ages.values()) == sorted(wanted.values())
        seen |= set(wanted.values())
    assert {0, 1, 2} <= seen


def ages_of(*scans):
    """Of the one object of each scan, -1: it has no trail."""
    return [min(ages.values(), default=-1) for ages, _ in followed(scans)]


def test_it_lasts_as_long_as_objects_touch():
    surely, perhaps = ([(3, 0, 0)], [HIGH]), ([(3.4, 0, 0)], [LOW])
    assert ages_of(surely, *4 * [perhaps]) == [0, 1, 2, 3, -1]
    assert ages_of(surely, perhaps, surely, perhaps) == [0, 1, 0, 1]
    assert ages_of(surely, ([(9, 0, 0)], [LOW]), perhaps) == [0, -1, -1]


def test_what_was_not_there_has_none():
    assert ages_of(([(3, 0, 0)], [LOW]), ([(3, 0, 0)], [LOW])) == [-1, -1]
    assert ages_of(([(3, 0, 0)], [HIGH]), ([(3, 0, 0)], [LEAST - 1]), ([(3, 0, 0)], [LOW])) == [0, -1, -1]

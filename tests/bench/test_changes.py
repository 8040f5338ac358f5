"""Changes of objects, and how long they go unseen."""

import numpy as np

from bench.changes import AFTER, BEFORE, Sight, lives, row, waits
from runtime.bundle.residual import HISTORY


def life(unseen):
    """An object that starts once its past is long enough, and is called moving so many scans later."""
    start = HISTORY + BEFORE
    return {i: Sight(i >= start, i >= start + unseen) for i in range(start - BEFORE, start + AFTER)}


def test_waits_are_counted_from_the_change():
    assert list(waits(life(0), starts=True)) == [0]
    assert list(waits(life(3), starts=True)) == [3]
    assert list(waits(life(AFTER + 5), starts=True)) == [AFTER]
    assert list(waits(life(3), starts=False)) == []
    stops = {i: Sight(not sight.moves, not sight.called) for i, sight in life(2).items()}
    assert list(waits(stops, starts=False)) == [2]


def test_objects_are_those_of_the_labels():
    labels = np.repeat(np.array([0, 252 | 7 << 16, 10 | 8 << 16], np.uint32), 30)
    moving = np.concatenate([np.zeros(45, bool), np.ones(45, bool)])
    assert list(lives([(labels, moving)])) == [{0: Sight(True, True)}, {0: Sight(False, True)}]
    assert row([]) == {"objects": 0, "median": None, "9 of 10": None, "not seen": None}
    assert row([1, 1, AFTER]) == {"objects": 3, "median": 1.0, "9 of 10": 9.8, "not seen": 1}

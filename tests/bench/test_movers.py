"""Movers are counted by kind and distance."""

import numpy as np

from bench.movers import Counts, Scan


def test_kinds_and_distances():
    points = np.zeros((6, 4), np.float32)
    points[:, 0] = 5, 15, 15, 25, 25, 60
    labels = np.array([252, 252, 254, 254, 10, 252], np.uint32)
    counts = Counts()
    counts.add(Scan(points, np.eye(4), labels, True), np.array([1, 0, 1, 1, 1, 0], bool))
    rows = counts.rows()
    assert rows["car, found"]["anywhere"] == 33.3
    assert rows["car, found"]["0 to 10 m"] == 100
    assert rows["car, found"]["10 to 20 m"] == 0
    assert rows["person, found"]["anywhere"] == 100
    assert rows["IoU"]["20 to 30 m"] == 50  # a parked car is called moving
    assert rows["IoU"]["anywhere"] == 50
    assert rows["IoU"]["30 to 50 m"] is None

"""A drive with fewer lasers keeps whole lasers, and their labels."""

import numpy as np

from bench.accuracy import Scan
from bench.sensors import ahead, thinned


def test_whole_lasers_are_kept():
    azimuth = np.tile(np.arange(0.5, 360), 6)
    laser = np.repeat(np.arange(6), 360)
    points = np.stack([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), -0.1 * laser, 0 * laser], 1)
    (scan,) = thinned(lambda: iter([Scan(points, np.eye(4), laser, True)]), 2)()
    assert set(scan.classes.tolist()) == {0, 2, 4}
    assert len(scan.points) == len(scan.classes) == 3 * 360


def test_what_is_ahead():
    points = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [1, -1, 0, 0]], np.float32)
    (scan,) = ahead(lambda: iter([Scan(points, np.eye(4), np.arange(4), True)]), 120)()
    assert scan.classes.tolist() == [0, 3]

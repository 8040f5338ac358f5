"""Other mountings see the same world."""

import numpy as np
import pytest

from bench.accuracy import Scan
from bench.mounting import MOUNTINGS, mounted, turned


@pytest.mark.parametrize("name", MOUNTINGS)
def test_points_stay_in_their_place_in_the_world(name):
    rng = np.random.default_rng(0)
    points, pose = rng.uniform(-9, 9, (50, 4)).astype(np.float32), turned(2, 30)
    points[3, :3], pose[:3, 3] = 0, (5, 6, 7)
    (scan,) = mounted(lambda: iter([Scan(points, pose, np.ones(50), True)]), MOUNTINGS[name])()
    both = scan, Scan(points, pose, np.ones(50), True)
    world, before = (one.points[:, :3] @ one.pose[:3, :3].T + one.pose[:3, 3] for one in both)
    assert not scan.points[3, :3].any()  # no return
    np.testing.assert_allclose(np.delete(world, 3, 0), np.delete(before, 3, 0), atol=1e-5)
    np.testing.assert_array_equal(scan.points[:, 3], points[:, 3])


def test_a_sensor_that_looks_down_sees_the_horizon_above():
    ahead = np.linalg.inv(MOUNTINGS["looking 5 degrees down"]) @ [10, 0, 0, 1]
    np.testing.assert_allclose(ahead[:3], [10 * np.cos(np.radians(5)), 0, 10 * np.sin(np.radians(5))])
    below = np.linalg.inv(MOUNTINGS["0.7 m lower"]) @ [10, 0, -1.7, 1]
    np.testing.assert_allclose(below[:3], [10, 0, -1])

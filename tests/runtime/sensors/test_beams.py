"""The beams of a scan, against a sensor that sees a round wall with all of them."""

import numpy as np
import pytest

from runtime.errors import ScanError
from runtime.sensors.beams import look
from runtime.sensors.registry import SENSORS


def wall(sensor, distance=20.0, steps=None):
    """Points (beams * firings, 3) and the ring of each: a round wall without end."""
    azimuth = np.linspace(-np.pi, np.pi, steps or sensor.azimuth_steps, endpoint=False)
    elevation = np.radians(sensor.elevations)
    ring, turn = np.meshgrid(np.arange(sensor.beams), azimuth, indexing="ij")
    height = distance * np.tan(elevation)[ring]
    points = np.stack([distance * np.cos(turn), distance * np.sin(turn), height], -1)
    return points.reshape(-1, 3), ring.reshape(-1)


@pytest.mark.parametrize("name", SENSORS)
def test_beams_and_firings_of_every_sensor(name):
    sensor = SENSORS[name]
    points, ring = wall(sensor)
    for given in (None, ring):
        seen = look(points, given)
        np.testing.assert_allclose(seen.angles, sensor.elevations, atol=1e-3)
        assert seen.firings == pytest.approx(sensor.azimuth_steps, rel=0.02)
        assert seen.turn == 360
        assert seen.regular > 0.6  # beams at very uneven angles are no fault


def test_order_and_second_returns_change_nothing():
    sensor = SENSORS["pandar40p"]
    points, _ = wall(sensor)
    want = look(points)
    twice = np.random.default_rng(0).permutation(np.concatenate([points, points * 1.1]))
    seen = look(twice)
    np.testing.assert_allclose(seen.angles, want.angles, atol=1e-3)
    assert seen.firings == pytest.approx(want.firings, rel=0.02)


def test_lasers_may_be_numbered_in_any_order_and_miss_most_returns():
    sensor = SENSORS["vlp16"]
    points, ring = wall(sensor)
    some = np.random.default_rng(0).random(len(points)) < 0.05
    numbers = np.random.default_rng(1).permutation(16)
    np.testing.assert_allclose(look(points[some], numbers[ring][some]).angles, sensor.elevations, atol=1e-3)


def test_numbers_that_are_no_lasers_are_not_used():
    points, ring = wall(SENSORS["hdl32e"])
    want = look(points)
    for wrong in (np.random.default_rng(0).permutation(ring), np.arange(len(points)), ring % 2):
        np.testing.assert_allclose(look(points, wrong).angles, want.angles, atol=1e-3)
    with pytest.raises(ScanError, match="ring"):
        look(points, ring[:-1])


def test_points_that_cannot_be_are_left_out():
    points, _ = wall(SENSORS["vlp16"])
    bad = np.array([[np.nan, 0, 0], [np.inf, 1, 1], [0, 0, 0], [1e30, 0, 0], [0.1, 0, 0]])
    want, seen = look(points), look(np.concatenate([bad, points]))
    np.testing.assert_array_equal(seen.angles, want.angles)
    assert look(bad) is None

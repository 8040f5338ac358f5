"""Scans of the sensors as the simulator makes them."""

import numpy as np
import pytest

from mos_model.simulator import simulate
from runtime.sensors.registry import SENSORS


def test_a_faster_motor_leaves_fewer_firings_to_a_turn():
    streets = [simulate(seed, 2) for seed in range(6)]
    rates = np.array([street.profile.rate for street in streets])
    steps = np.array([street.profile.azimuth_steps for street in streets])
    assert rates.std() > 0.05
    assert (np.abs(rates - 10) <= 0.4).all()
    np.testing.assert_allclose(rates * steps, 20830, rtol=1e-3)


@pytest.mark.parametrize("name", SENSORS)
def test_a_scan_of_every_sensor(name):
    profile = SENSORS[name]
    frame = simulate(4, 2, name, movers=0, sensor_variation=False, street="urban", scan_motion="off")[1]
    most = profile.beams * profile.azimuth_steps
    assert 0.3 * most < len(frame.points) < most
    distance = np.linalg.norm(frame.points[:, :3], axis=1)
    assert distance.min() > profile.min_range - 0.5
    assert distance.max() < profile.max_range + 0.5
    elevation = np.degrees(np.arcsin(frame.points[:, 2] / distance))
    assert elevation.max() < profile.elevations[0] + 5
    assert elevation.min() > profile.elevations[-1] - 1

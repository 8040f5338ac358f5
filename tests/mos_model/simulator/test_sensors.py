import dataclasses

import numpy as np
import pytest

from mos_model.simulator import simulate
from runtime.errors import SettingError
from runtime.sensors.registry import SENSORS, find_sensor

BEAMS = {"hdl64e": 64, "hdl32e": 32, "vlp16": 16, "os1-32": 32, "os1-64": 64, "os1-128": 128}


def test_every_sensor_has_its_beams():
    assert {name: profile.beams for name, profile in SENSORS.items()} == BEAMS


def test_hdl64e_has_a_fine_and_a_coarse_block():
    elevation = np.array(SENSORS["hdl64e"].elevations)
    assert elevation[0] == pytest.approx(2.0)
    assert elevation[-1] == pytest.approx(-24.33)
    assert np.diff(elevation[:32]).mean() == pytest.approx(-1 / 3, abs=1e-9)
    assert np.diff(elevation[32:]).mean() == pytest.approx(-1 / 2, abs=1e-9)


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


def test_unknown_sensor_is_named():
    with pytest.raises(SettingError, match=r"hdl65.*hdl64e"):
        find_sensor("hdl65")


@pytest.mark.parametrize(
    "change",
    [
        {"elevations": (1.0, 2.0)},
        {"azimuth_steps": 0},
        {"rate": 0.0},
        {"min_range": 90.0},
        {"lifts": (0.1, 0.2, 0.3)},
    ],
)
def test_profiles_that_cannot_be(change):
    with pytest.raises(SettingError):
        dataclasses.replace(SENSORS["hdl64e"], **change)

"""What a sensor may be."""

import dataclasses

import numpy as np
import pytest

from runtime.errors import SettingError
from runtime.sensors.registry import SENSORS
from runtime.sensors.sensor import Sensor, even


def test_hdl64e_has_a_fine_and_a_coarse_block():
    elevation = np.array(SENSORS["hdl64e"].elevations)
    assert elevation[0] == pytest.approx(2.0)
    assert elevation[-1] == pytest.approx(-24.33)
    assert np.diff(elevation[:32]).mean() == pytest.approx(-1 / 3, abs=1e-9)
    assert np.diff(elevation[32:]).mean() == pytest.approx(-1 / 2, abs=1e-9)


@pytest.mark.parametrize(("beams", "height"), [(10, 16), (16, 16), (17, 32), (40, 48), (64, 64)])
def test_any_number_of_beams_has_a_range_image(beams, height):
    image = Sensor("any", even(15.0, -25.0, beams), 1800).range_image
    step = 40 / (beams - 1)
    assert image.height == height
    assert image.fov_up == pytest.approx(15 + step / 2)
    assert (image.fov_up - image.fov_down) / height == pytest.approx(step)


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
def test_sensors_that_cannot_be(change):
    with pytest.raises(SettingError):
        dataclasses.replace(SENSORS["hdl64e"], **change)

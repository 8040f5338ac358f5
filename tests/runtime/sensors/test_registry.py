"""The sensors by their names; a new one is an entry in a file and a line in the registry."""

import numpy as np
import pytest

from mos_model.simulator import simulate
from runtime.bundle.residual import Residual
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.image.inputs import InputBuilder
from runtime.sensors.registry import SENSORS, find_sensor

BEAMS = {
    **{"hdl64e": 64, "hdl32e": 32, "vlp16": 16, "vlp32c": 32, "vls128": 128},
    **{f"os{model}-{beams}": beams for model in range(3) for beams in (32, 64, 128)},
    **{"pandar40p": 40, "pandar64": 64, "xt16": 16, "xt32": 32, "qt64": 64},
    **{"rs16": 16, "rs32": 32, "ruby": 128},
}


def test_every_sensor_has_its_beams():
    assert {name: sensor.beams for name, sensor in SENSORS.items()} == BEAMS


def test_unknown_sensor_is_named():
    with pytest.raises(SettingError, match=r"hdl65.*hdl64e"):
        find_sensor("hdl65")


def rows_of_beams(sensor):
    """The row of the range image that a return of each beam falls into."""
    elevation = np.radians(sensor.elevations)
    points = 10 * np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation), 0 * elevation], axis=1)
    builder = InputBuilder(sensor.range_image, Residual(), Workers(1))
    return builder.build(builder.enter(points.astype(np.float32)), []).pixel // sensor.range_image.width


@pytest.mark.parametrize("name", SENSORS)
def test_every_beam_is_in_the_range_image(name):
    sensor = SENSORS[name]
    image = sensor.range_image
    assert all(image.fov_down < elevation < image.fov_up for elevation in sensor.elevations)
    assert (np.diff(rows_of_beams(sensor)) >= 0).all()
    if np.ptp(np.diff(sensor.elevations)) < 1e-9:
        assert np.array_equal(rows_of_beams(sensor), np.arange(sensor.beams))


def test_a_new_sensor_is_one_entry(contributed, monkeypatch):
    """It has a range image, and is simulated by its name."""
    new = contributed("runtime/sensors/acme.py").A20
    monkeypatch.setitem(SENSORS, new.name, new)
    assert find_sensor("a20") is new
    assert new.beams % 16  # the image is as high as the network wants it all the same
    assert np.array_equal(rows_of_beams(new), np.arange(new.beams))
    frame = simulate(3, 1, "a20", street="urban", scan_motion="off")[0]
    assert 0.3 < len(frame.points) / (new.beams * new.azimuth_steps) < 1
    elevation = np.degrees(np.arcsin(frame.points[:, 2] / np.linalg.norm(frame.points[:, :3], axis=1)))
    assert len(np.unique(np.abs(elevation[:, None] - new.elevations).argmin(axis=1))) == new.beams

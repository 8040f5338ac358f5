"""Drives of all sensors: each is a function of its number, and fills batches of one shape."""

from collections import Counter
from random import Random

import numpy as np
import pytest

from mos_model.data.augment import ANY_SENSOR
from mos_model.data.dataset import SampleConfig
from mos_model.data.mixture import MixedDrives, draw_sensor, thinned, unknown
from mos_model.data.stream import Stream
from runtime.errors import SettingError
from runtime.sensors.registry import SENSORS
from runtime.sensors.velodyne import HDL64E

DRIVES = MixedDrives(SampleConfig(augmentation=ANY_SENSOR, crop=512), seed=3, frames=2, crops=2)


def test_a_drive_is_a_function_of_its_number():
    first, again = DRIVES.group(1), DRIVES.group(1)
    assert len(first) == DRIVES.group_size == 4
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a.image, b.image)
        assert np.array_equal(a.labels, b.labels)


def test_batches_hold_images_of_one_shape():
    with Stream(DRIVES, 4, mix=5, workers=0) as stream:
        batches = [batch for batch, _ in zip(stream, range(5), strict=False)]
    assert all(len({sample.image.shape for sample in batch}) == 1 for batch in batches)
    assert len({batch[0].image.shape for batch in batches}) > 1
    with Stream(DRIVES, 4, mix=5, workers=0, position=3) as stream:
        assert np.array_equal(next(iter(stream))[0].image, batches[3][0].image)


def test_shapes_that_fill_no_batches_are_refused():
    with Stream(DRIVES, 3, mix=5, workers=0) as stream, pytest.raises(SettingError, match="multiple of it"):
        next(iter(stream))


def test_every_sensor_is_drawn_and_more():
    rng = Random(0)
    drawn = Counter(draw_sensor(rng, "hdl64e").name for _ in range(2000))
    assert set(SENSORS) <= set(drawn)
    assert drawn["hdl64e"] > 300
    assert sum(count for name, count in drawn.items() if name in ("vlp16", "rs16", "xt16")) > 400
    assert drawn["unknown"] > 50
    assert sum(count for name, count in drawn.items() if "/" in name) > 50


def test_thinned_beams_are_those_of_the_sensor():
    sensor = thinned(HDL64E, 4, 1)
    assert sensor.elevations == HDL64E.elevations[1::4]
    assert sensor.lifts == (0.203,) * 8 + (0.113,) * 8
    assert sensor.range_image.elevations == sensor.elevations


def test_unknown_sensors_have_a_range_image():
    rng = Random(1)
    for _ in range(200):
        sensor = unknown(rng, HDL64E)
        image = sensor.range_image
        assert image.height >= sensor.beams
        assert -90 <= sensor.elevations[-1] < sensor.elevations[0] <= 90

"""What the tests of views share that are not the sensor's own."""

import numpy as np

from runtime.bundle.residual import Residual
from runtime.compute.workers import Workers
from runtime.image.history import Past
from runtime.image.inputs import InputBuilder
from runtime.sensors.range_image import RangeImage

IMAGE = RangeImage(16, 64)


def build(inputs, points, past=()):
    """The input for a scan; past: (points, T_current_past) or None of each scan before."""
    return inputs.build(inputs.enter(points), [None if one is None else Past(*one) for one in past])


def check_range_image(inputs, points):
    """It is the sensor's, of a scan that some points are missing from and that may not be written to."""
    points[::7] = np.nan
    points.setflags(write=False)
    build(inputs, points)
    want = build(InputBuilder(IMAGE, Residual((1,)), Workers(1)), points).nearest
    np.testing.assert_array_equal(inputs.range_image(inputs.enter(points)), want)

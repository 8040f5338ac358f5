"""Scans as belief gets them."""

import numpy as np

from runtime.belief.free_space import Sight
from runtime.sensors.range_image import RangeImage

RANGE_IMAGE = RangeImage(16, 96, 20.0, -20.0)


def unseen():
    """A range image of nothing."""
    return np.zeros((RANGE_IMAGE.height, RANGE_IMAGE.width), np.float32)


def sight_of(scan, pose):
    """The first scan, as if seen from `pose`."""
    return Sight(scan.points, pose, 0, unseen())

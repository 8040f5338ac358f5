"""What simulated movers do, by the way they go."""

import math

import numpy as np
import pytest

from bench.manners import CROSSES, IN_PLACE, MANNERS, ONCOMING, RECENT, SAME, STARTS, manner, manners
from mos_model.simulator import simulate
from runtime.classes import MOVING, STATIC, to_classes


@pytest.mark.parametrize(
    ("degrees", "want"), [(0, SAME), (40, SAME), (50, CROSSES), (-90, CROSSES), (130, CROSSES), (140, ONCOMING)]
)
@pytest.mark.parametrize("heading", [0.0, 2.0, -3.0])
def test_the_angle_to_the_sensors_heading_decides(degrees, want, heading):
    ahead = np.array([math.cos(heading), math.sin(heading)])
    angle = heading + math.radians(degrees)
    way = 0.3 * np.array([math.cos(angle), math.sin(angle)])
    assert manner(way, ahead, stood=False, speed=3.0) == want
    assert manner(way, ahead, stood=True, speed=3.0) == STARTS
    assert manner(0 * way, ahead, stood=False, speed=0.0) == IN_PLACE


def test_the_manners_of_a_drive_against_its_labels():
    """Each mover has one; who was labelled static within the last second starts."""
    seen = set()
    for seed in range(18_690_000, 18_690_003):
        drive = simulate(seed, 20, "vlp16", version=2, movers=2.5, street="urban", rate=10.0)
        stood = {}  # the last scan in which an instance was seen to stand
        for k, frame in enumerate(drive):
            found = manners(drive, k)
            labels = np.unique(frame.labels[frame.labels >> 16 > 0])
            classes, instances = to_classes(labels), labels >> 16
            for one in instances[classes == MOVING].tolist():
                seen.add(found[one])
                if k - stood.get(one, -99) <= RECENT * drive.profile.rate:
                    assert found[one] == STARTS
            stood |= dict.fromkeys(instances[classes == STATIC].tolist(), k)
            assert not set(found) & set(instances[classes == STATIC].tolist())
    assert {STARTS, CROSSES, SAME, ONCOMING} <= seen <= set(MANNERS)

"""The ground is found where there is one, whatever the axes and the unit."""

import numpy as np
import pytest

from bench.mounting import turned
from runtime.doctor.check_ground import check_ground
from runtime.doctor.sample import Sample
from tests.support import street


def seen(transform=None, scale=1.0, height=1.8, seed=7):
    """A sample of a street in the axes of T_new_old."""
    pose = street.drive(1)[0]
    pose[2, 3] = height
    points = street.scan(pose, street.boxes(seed))
    if transform is not None:
        points[:, :3] = points[:, :3] @ transform[:3, :3].T
    points[:, :3] *= scale
    return Sample.of(points)


def found(*samples):
    finding = check_ground(samples)
    return finding.level, finding.text


@pytest.mark.parametrize("scale", [0.01, 1.0, 3.28, 1000.0])
def test_height_in_any_unit(scale):
    ground = seen(scale=scale).ground
    assert ground.height == pytest.approx(1.8 * scale, rel=0.01)
    assert ground.tilt < 0.5


@pytest.mark.parametrize(("down", "leaning"), [(5, 0), (-8, 0), (0, 6), (4, -3), (0, 0)])
def test_level(down, leaning):
    ground = seen(np.linalg.inv(turned(1, down) @ turned(0, leaning))).ground
    assert ground.pitch == pytest.approx(-down, abs=0.5)
    assert ground.roll == pytest.approx(leaning, abs=0.5)


def test_what_is_said():
    level, text = found(seen())
    assert (level, text.startswith("1.80 m below the sensor")) == ("ok", True)
    assert found(seen(turned(1, -3)))[0] == "warn"
    assert "looks 10.0 degrees down" in found(seen(turned(1, -10)))[1]
    assert found(seen(turned(1, -10)))[0] == "bad"
    assert found(seen(height=1.1))[0] == "warn"
    assert found(seen(height=2.9))[0] == "ok"
    assert found(seen(height=3.4))[0] == "warn"
    assert "metres?" in found(seen(scale=3.28))[1]
    assert "upside down" in found(seen(turned(0, 180)))[1]
    for turn in (turned(0, 90), turned(0, -90), turned(1, 90)):
        assert "beside it, tilted by 90" in found(seen(turn))[1]


def test_no_single_sample_decides():
    wrong, right = seen(turned(1, -10)), seen()
    assert found(right, wrong, right)[0] == "ok"
    assert found(wrong, right, wrong)[0] == "bad"


def test_a_sensor_that_sways_is_not_tilted():
    swaying = [seen(turned(0, angle)) for angle in (-8, 7, 0.5)]
    assert check_ground(swaying).level == "ok"


def room(length, width, height, at):
    """Walls and ceiling as boxes, seen from the middle at a height, by 16 beams and by 32 that look far up and down."""
    x, y = length / 2, width / 2
    sides = [[[x, -y, 0], [x + 1, y, 9]], [[-x - 1, -y, 0], [-x, y, 9]], [[-x, y, 0], [x, y + 1, 9]]]
    boxes = np.array([*sides, [[-x, -y - 1, 0], [x, -y, 9]], [[-x, -y, height], [x, y, height + 1]]])
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.2, at
    return [Sample.of(street.scan(pose, boxes, rows, 360, fov)) for rows, fov in ((16, (15, -15)), (32, (45, -45)))]


@pytest.mark.parametrize("at", [0.2, 0.5, 1.2, 1.7, 2.1])
@pytest.mark.parametrize("size", [(4, 3, 2.5), (8, 6, 2.7), (15, 10, 2.5), (30, 20, 4), (40, 30, 8)])
def test_a_room_is_no_street_upside_down(size, at):
    for sample in room(*size, at):
        assert check_ground([sample]).level != "bad"


@pytest.mark.parametrize("points", [np.ones((1, 4)), np.ones((500, 4)), np.tile([[0.5, 1, 2, 0]], (9, 1))])
def test_points_without_a_plane(points):
    assert Sample.of(points.astype(np.float32)).ground is None


def test_points_all_around_have_no_ground():
    rng = np.random.default_rng(0)
    cloud = np.concatenate([rng.normal(0, 9, (3000, 3)), np.zeros((3000, 1))], 1).astype(np.float32)
    assert found(Sample.of(cloud)) == ("ok", "none in sight, so that height and level of the sensor are not known")

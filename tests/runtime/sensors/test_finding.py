"""The sensor of a scan, by its points alone: simulated scans of every profile, and real ones of two."""

import numpy as np
import pytest

from mos_model.simulator import simulate
from runtime.sensors.finding import find_from_scan
from runtime.sensors.registry import SENSORS
from tests.support.paths import SHARED

SAME_TABLE = {"vlp16", "rs16", "xt16"}  # 16 beams, 2 degrees apart


def real(path):
    if not (SHARED / path).exists():
        pytest.skip(f"needs {path} of the shared data")
    return np.fromfile(SHARED / path, np.float32).reshape(-1, 4)


@pytest.mark.parametrize("name", SENSORS)
def test_profiles_are_found_in_their_scans(name):
    """The name, or that of one with as many beams in nearly the same view; at the right number of columns."""
    sensor = SENSORS[name]
    settings = {"street": "urban", "sensor_variation": False, "movers": 1.0}
    found = find_from_scan(simulate(4, 1, name, **settings)[0].points)
    nearest = SENSORS[found.nearest]
    assert abs(nearest.beams - sensor.beams) <= 0.25 * sensor.beams
    assert abs(nearest.elevations[-1] - sensor.elevations[-1]) < 6
    assert found.sensor.range_image.width == pytest.approx(sensor.range_image.width, rel=0.13)
    if name in SAME_TABLE:
        assert found.nearest in SAME_TABLE


def test_order_of_the_points_does_not_matter():
    points = simulate(4, 1, "pandar40p", street="urban", sensor_variation=False)[0].points
    found = find_from_scan(points)
    assert found.nearest == "pandar40p"
    assert find_from_scan(np.random.default_rng(0).permutation(points)) == found


def test_a_slower_turn_has_more_firings():
    for rate, columns in ((10.0, 1792), (20.0, 896)):
        turning = SENSORS["vlp16"].spinning(rate / 10)
        points = simulate(4, 1, turning, street="urban", sensor_variation=False)[0].points
        assert find_from_scan(points).sensor.range_image.width == columns


def test_beams_that_no_sensor_has_get_rows_of_their_own():
    points = simulate(4, 1, "hdl32e", street="urban", sensor_variation=False)[0].points
    points[:, 2] += np.float32(0.3) * np.hypot(points[:, 0], points[:, 1])  # some 17 degrees up
    found = find_from_scan(points)
    assert found.sensor.name == "found"
    assert "much like" in found.text
    assert 28 <= found.sensor.beams <= 48


def test_part_of_a_turn_is_said():
    points = simulate(4, 1, "os1-64", street="urban", sensor_variation=False)[0].points
    ahead = points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < np.radians(60)]
    assert "120 degrees wide" in find_from_scan(ahead).text
    assert "wide" not in find_from_scan(points).text


@pytest.mark.parametrize("points", [np.zeros((0, 4)), np.full((900, 4), np.nan), np.ones((900, 3))])
def test_nothing_to_see_is_no_sensor(points):
    assert find_from_scan(points.astype(np.float32)) is None


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("data/kitti/sequences/00/velodyne/000003.bin", "hdl64e"),
        ("data/kitti/sequences/90/velodyne/000020.bin", "hdl64e"),
        ("data/pandaset/sequences/002/velodyne/000010.bin", "pandar64"),
    ],
)
def test_real_scans(path, name):
    found = find_from_scan(real(path))
    assert found.sensor.name == found.nearest == name


@pytest.mark.parametrize(("step", "beams"), [(2, 32), (4, 16)])
def test_a_real_scan_with_some_of_its_lasers(step, beams):
    """The file holds one laser after the other."""
    points = real("data/kitti/sequences/90/velodyne/000020.bin")
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360
    laser = np.cumsum(np.concatenate([[0], np.diff(azimuth) < -180]))
    found = find_from_scan(points[laser % step == 0])
    assert found.sensor.beams == beams
    assert found.sensor.elevations[0] - found.sensor.elevations[-1] == pytest.approx(26, abs=2)

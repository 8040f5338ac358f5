"""Scans in another frame than that of their sensor: which, by the beams alone."""

import numpy as np
import pytest

from mos_model.simulator import simulate
from runtime.sensors.finding import find_from_scan
from runtime.sensors.mounting import own_frame
from tests.support.paths import SHARED

KITTI = SHARED / "data/kitti/sequences/90/velodyne/000010.bin"


def pose(pitch=0.0, roll=0.0, shift=(0.0, 0.0, 0.0)):
    """(4, 4) by degrees about y, then about x, and m."""
    p, r = np.radians((pitch, roll))
    about_y = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = about_x @ about_y, shift
    return made


def moved(points, transform):
    return points[:, :3].astype(np.float64) @ transform[:3, :3].T + transform[:3, 3]


def assert_undone(mounting, transform, degrees=0.4, metres=0.2):
    left = mounting @ transform
    assert np.degrees(np.arccos(min(1.0, (np.trace(left[:3, :3]) - 1) / 2))) < degrees
    assert np.abs(left[:3, 3]).max() < metres


@pytest.fixture(scope="module")
def scans():
    settings = {"street": "urban", "sensor_variation": False}
    return {name: simulate(4, 1, name, **settings)[0].points for name in ("hdl32e", "vlp16", "os1-64", "pandar64")}


@pytest.mark.parametrize("name", ["hdl32e", "vlp16", "os1-64", "pandar64"])
@pytest.mark.parametrize(
    "transform", [pose(5), pose(-5), pose(0, 8), pose(3, -4), pose(shift=(0, 0, 0.7)), pose(shift=(0, 0, -0.6))]
)
def test_the_frame_of_a_scan_becomes_that_of_the_sensor(scans, name, transform):
    found = find_from_scan(moved(scans[name], transform))
    assert found.sensor.name == name
    if found.mounting is None:  # where too few beams are seen in full; the sensor is found all the same
        assert name == "pandar64"
        assert transform[2, 3] > 0
    else:
        assert_undone(found.mounting, transform)
        assert "which is undone" in found.text


@pytest.mark.parametrize("name", ["hdl32e", "vlp16", "os1-64", "pandar64"])
def test_the_frame_of_a_vehicle_where_the_laser_of_each_point_is_known(scans, name):
    points, transform = scans[name], pose(4, 1, (1.4, 0.2, 1.6))
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360
    ring = np.cumsum(np.concatenate([[0], np.diff(azimuth) < -180]))  # the simulator gives one laser after the other
    found = find_from_scan(moved(points, transform), ring)
    assert found.sensor.name == name
    assert_undone(found.mounting, transform)


@pytest.mark.parametrize("name", ["hdl32e", "vlp16", "os1-64", "pandar64"])
@pytest.mark.parametrize("transform", [pose(shift=(0, 0, 1.7)), pose(shift=(1.3, 0, 1.7))])
def test_the_frame_of_a_vehicle_is_found_from_the_points_alone(scans, name, transform):
    found = find_from_scan(moved(scans[name], transform))
    assert found.sensor.name == name
    assert_undone(found.mounting, transform)


@pytest.mark.parametrize("name", ["hdl32e", "vlp16", "os1-64", "pandar64"])
def test_the_frame_of_the_sensor_stays(scans, name):
    for transform in (pose(), pose(1), pose(0, -1), pose(shift=(0.3, 0.2, 0.2))):
        assert find_from_scan(moved(scans[name], transform)).mounting is None


def test_motion_within_the_turn_is_no_mounting():
    for seed in range(4):
        points = simulate(seed, 1, "os1-64", street="country", scan_motion="compensated")[0].points
        assert find_from_scan(points).mounting is None


@pytest.mark.skipif(not KITTI.is_file(), reason="needs the KITTI scans in ../shared")
@pytest.mark.parametrize("transform", [pose(5), pose(-5), pose(shift=(0, 0, 0.7))])
def test_real_scans(transform):
    """Beams that do not leave from one point are the sensor's own; its frame lies below them."""
    points = np.fromfile(KITTI, np.float32).reshape(-1, 4)
    assert find_from_scan(points).mounting is None
    found = find_from_scan(moved(points, transform))
    assert found.sensor.name == "hdl64e"
    assert_undone(found.mounting, transform)


def test_clouds_without_beams_have_no_frame_of_their_own():
    points = np.random.default_rng(0).normal(size=(20_000, 3)) * (20, 20, 2)
    found = find_from_scan(points)
    assert found.mounting is None
    assert "hardly to be told apart" in found.text


def test_steps_that_lead_nowhere_are_given_up(scans):
    from runtime.sensors.beams import look

    ahead = scans["os1-64"][scans["os1-64"][:, 0] > 0]
    narrow = ahead[np.abs(ahead[:, 1]) < 0.1 * ahead[:, 0]]
    seen = look(narrow)
    assert own_frame(narrow, None, seen)[1] is None

"""One wild return among many: labels far from it stay what they were."""

import numpy as np
import pytest

from runtime import MosRunner
from runtime.sensors.registry import SENSORS
from tests.support import street

BEYOND = np.radians(20)  # of azimuth


@pytest.fixture(scope="module")
def scans():
    world = street.boxes()
    return [(street.scan(pose, world, rows=64, columns=900), pose) for pose in street.drive(4)]


@pytest.fixture(scope="module")
def runner():
    """The network that ships: its channel means see the whole image."""
    return MosRunner(threads=2, sensor="hdl64e", belief="none", precision="float32")


def probability(runner, scans, last):
    runner.reset()
    for scan, pose in scans[:-1]:
        runner.remember(scan, pose)
    return runner(last, scans[-1][1]).probability


@pytest.mark.parametrize("distance", [SENSORS["hdl64e"].reach + 1, 200, 1e5, 1e30, np.inf])
def test_a_return_from_where_none_comes(runner, scans, distance):
    scan = scans[-1][0]
    want = probability(runner, scans, scan)
    stray = np.array([[0, distance * np.cos(0.2), -distance * np.sin(0.2), 0.3]], np.float32)
    got = probability(runner, scans, np.vstack([scan, stray]))
    assert got[-1] == 0
    np.testing.assert_array_equal(got[:-1], want)


@pytest.mark.parametrize("remission", [1e10, -1e10, 3e38])
def test_a_wild_remission(runner, scans, remission):
    scan = scans[-1][0].copy()
    want = probability(runner, scans, scan)
    wild = np.argmin(np.linalg.norm(scan[:, :3], axis=1))  # the nearest of its pixel
    scan[wild, 3] = remission
    got = probability(runner, scans, scan)
    azimuth = np.arctan2(scan[:, 1], scan[:, 0])
    apart = np.abs((azimuth - azimuth[wild] + np.pi) % (2 * np.pi) - np.pi)
    np.testing.assert_allclose(got[apart > BEYOND], want[apart > BEYOND], atol=0.01)
    assert (got != want).any()


@pytest.mark.parametrize("place", [(-110, -3, -1), (30, -100, -1.5), (12, 5, -9.3), (8, 2, 0.5)])
def test_a_return_within_reach(runner, scans, place):
    """Also one that lies lower, or farther out, than all others: voxels and their strides do not begin with it."""
    scan = scans[-1][0]
    want = probability(runner, scans, scan)
    got = probability(runner, scans, np.vstack([scan, np.array([[*place, 0.3]], np.float32)]))[:-1]
    azimuth = np.arctan2(scan[:, 1], scan[:, 0]) - np.arctan2(place[1], place[0])
    apart = np.abs((azimuth + np.pi) % (2 * np.pi) - np.pi) > BEYOND
    assert (want > 0.2).sum() > 100  # candidates of the point head
    assert (np.abs(got - want)[apart] > 0.02).sum() <= 5


def test_ordinary_remission_is_as_it_was(runner, scans):
    """At the ends of its range too: what is cut off lies beyond."""
    scan = scans[-1][0]
    inputs = runner._stages.inputs
    for remission in (0.0, 0.3, 1.0):
        scan = scan.copy()
        scan[:, 3] = remission
        image = inputs.build(inputs.enter(scan), [])
        mean, std = (part[4] for part in (runner.sensor.range_image.mean, runner.sensor.range_image.std))
        seen = image.image[4][image.first >= 0]
        np.testing.assert_allclose(seen, np.float32((remission - mean) / std), rtol=1e-6)

"""Poses that come while scans wait for them."""

import threading
import time
from types import SimpleNamespace as Of

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.errors import PoseError
from runtime.live.pose_feed import PoseFeed
from runtime.recordings.recording import Options

START = 1_700_000_000.0  # s
MOUNT = np.eye(4)
MOUNT[:3, 3] = 0.5, 0, 1


def pose(x):
    at = np.eye(4)
    at[:3, :3] = Rotation.from_euler("z", 5 * x, degrees=True).as_matrix()
    at[0, 3] = x
    return at


def stamp(seconds):
    nanoseconds = round(1e9 * (START + seconds))
    return Of(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def parts(at):
    turn = dict(zip("xyzw", Rotation.from_matrix(at[:3, :3]).as_quat(), strict=True))
    return Of(**dict(zip("xyz", at[:3, 3], strict=True))), Of(**turn)


def odometry(x, seconds, child="base"):
    place, turn = parts(pose(x))
    return Of(header=Of(stamp=stamp(seconds)), child_frame_id=child, pose=Of(pose=Of(position=place, orientation=turn)))


def transforms(at, seconds, parent, child):
    place, turn = parts(at)
    header = Of(stamp=stamp(seconds), frame_id=parent)
    return Of(transforms=[Of(header=header, child_frame_id=child, transform=Of(translation=place, rotation=turn))])


def test_a_scan_waits_for_the_pose_after_it():
    feed = PoseFeed(Options(pose_topic="/odom"), patience=30.0)
    assert "nothing came on /odom" in feed.missing("base")
    feed.add_odometry(odometry(0.0, 0.0))

    def later():
        time.sleep(0.2)
        feed.add_odometry(odometry(1.0, 0.1))

    thread = threading.Thread(target=later)
    thread.start()
    found = feed.pose("base", START + 0.05)
    thread.join()
    np.testing.assert_allclose(found, pose(0.5) @ np.diag([1, 1, 1, 1.0]), atol=1e-6)


def test_where_none_follows_the_motion_goes_on_for_a_step():
    feed = PoseFeed(Options(pose_topic="/odom"), patience=0.0)
    for index in range(5):
        feed.add_odometry(odometry(0.1 * index, 0.05 * index))
    np.testing.assert_allclose(feed.pose("base", START + 0.24), pose(0.48), atol=1e-4)
    with pytest.raises(PoseError, match="has no pose at"):
        feed.pose("base", START + 0.3)


def test_odometry_of_a_frame_that_carries_the_lidar():
    feed = PoseFeed(Options(pose_topic="/odom"), patience=0.0)
    feed.add_odometry(odometry(2.0, 0.0))
    with pytest.raises(PoseError, match=r"those of base, the points are in lidar, and no TF says .* \(`extrinsics`\)"):
        feed.pose("lidar", START)
    feed.add_transforms(transforms(MOUNT, 0.0, "base", "lidar"), static=True)
    np.testing.assert_allclose(feed.pose("lidar", START), pose(2.0) @ MOUNT, atol=1e-6)
    given = PoseFeed(Options(pose_topic="/odom", extrinsics="0.5 0 1 0 0 0 1"), patience=0.0)
    given.add_odometry(odometry(2.0, 0.0))
    np.testing.assert_allclose(given.pose("lidar", START), pose(2.0) @ MOUNT, atol=1e-6)


@pytest.mark.parametrize("world", [None, "map"])
def test_tf_is_bounded_and_begins_anew_when_a_recording_does(world):
    feed = PoseFeed(Options(world=world), patience=0.0)
    feed.add_transforms(transforms(MOUNT, 0.0, "base", "lidar"), static=True)
    assert "lidar ends at base" in feed.missing("lidar") or "map (`world`) is not above" in feed.missing("lidar")
    for _ in range(2):  # the second time, from the beginning
        for index in range(900):
            feed.add_transforms(transforms(pose(0.01 * index), 0.1 * index, "odom", "base"), static=False)
            feed.add_transforms(transforms(pose(1.0), 0.1 * index, "map", "odom"), static=False)
        expected = (np.eye(4) if world is None else pose(1.0)) @ pose(8.99) @ MOUNT
        np.testing.assert_allclose(feed.pose("lidar", START + 89.9), expected, atol=1e-6)
        with pytest.raises(PoseError, match="has no pose at"):
            feed.pose("lidar", START + 10.0)
        assert all(len(link.rows) < 250 for link in feed._frames().links.values())
    assert feed.origin("lidar") == f"TF from {world or 'odom'} to lidar"

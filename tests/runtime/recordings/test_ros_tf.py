"""Poses from TF, and where the LiDAR sits by it."""

import logging
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.commands.main import main
from runtime.errors import MosWarning, PoseError, SequenceError, SettingError
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support import street
from tests.support.bag_writers import KINDS, BagWriter

pytest.importorskip("rosbags")
COUNT = 6
DRIVE = street.drive(COUNT)  # T_odom_lidar, 0.1 s apart


def placed(x, y, z, yaw):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", yaw, degrees=True).as_matrix()
    pose[:3, 3] = x, y, z
    return pose


MOUNT, TOP, DRIFT = (
    placed(0.8, 0, 1.7, 90),
    placed(0, 0, 0.1, 0),
    placed(5, 2, 0, 10),
)  # in base_link, above it, of odom
BASE = DRIVE @ np.linalg.inv(MOUNT)


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def write(tmp_path, kind):
    """A bag of clouds in `lidar` and what is to be written beside them."""
    path = tmp_path / ("log.bag" if kind == "bag" else "log")

    def call(*others):
        with BagWriter(path, kind) as bag:
            for index in range(COUNT):
                bag.cloud(np.ones((9, 4), np.float32), 0.1 * index)
            for other in others:
                other(bag)
        return path

    return call


def static(pose=MOUNT, parent="base_link", child="lidar"):
    return lambda bag: bag.transform(pose, 0.0, parent, child, topic="/tf_static")


def moving(poses=BASE, parent="odom", child="base_link", end=10.0):
    """From the first scan to after the last or `end`, ten times a scan; between two poses as they go on."""

    def call(bag):
        steps = [np.linalg.inv(one) @ two for one, two in pairwise(poses)]
        for index in range(len(poses)):
            for part in range(10 if 0.1 * index < end else 0):
                step = np.eye(4)
                if index < len(steps):
                    turn = Rotation.from_matrix(steps[index][:3, :3]).as_rotvec() * part / 10
                    step[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
                    step[:3, 3] = steps[index][:3, 3] * part / 10
                bag.transform(poses[index] @ step, 0.1 * index + 0.01 * part, parent, child)

    return call


def test_from_the_world_to_the_points(write, caplog):
    """odom -> base_link moves, base_link -> top -> lidar does not; names may begin with a slash, as once in ROS 1."""
    caplog.set_level(logging.INFO, "lidar_mos")
    path = write(moving(), static(MOUNT @ np.linalg.inv(TOP), "/base_link", "/top"), static(TOP, "top", "lidar"))
    recording = open_recording(path)
    np.testing.assert_allclose(recording.poses, DRIVE, atol=1e-6)
    assert recording.poses_from == "/tf and /tf_static from odom to lidar"
    assert recording.poses_from in caplog.text
    assert open_recording(path, Options(pose_topic="/tf")).poses_from == recording.poses_from


def test_odom_before_map(write):
    """The map jumps to where a localiser finds itself; the motion is that in odom. Without one, the map has it."""
    jumps = np.array([DRIFT if index < 3 else np.eye(4) for index in range(COUNT)])
    path = write(moving(), static(), moving(jumps, "map", "odom"))
    np.testing.assert_allclose(open_recording(path).poses, DRIVE, atol=1e-6)


def test_a_map_whose_odom_does_all(write):
    path = write(moving(parent="map", child="odom"), static(np.eye(4), "odom", "base_link"), static())
    recording = open_recording(path)
    np.testing.assert_allclose(recording.poses, DRIVE, atol=1e-6)
    assert "from map to lidar" in recording.poses_from


def test_a_sensor_that_stands(write):
    recording = open_recording(write(static(), static(DRIFT, "map", "base_link")))
    np.testing.assert_allclose(recording.poses, [DRIFT @ MOUNT] * COUNT, atol=1e-12)


@pytest.mark.parametrize(
    ("links", "words"),
    [
        ([moving()], r"lidar has nothing above it; there are the frames base_link, odom"),
        ([static()], r"lidar ends at base_link, and nothing moves up to there; .* base_link, lidar"),
        (
            [moving(), static(parent="chassis")],
            r"lidar ends at chassis, and nothing moves .*base_link, chassis, lidar, odom",
        ),
    ],
)
def test_a_missing_link(write, links, words):
    path = write(*links)
    for options in (Options(), Options(pose_topic="/tf" if len(links) > 1 else None)):
        with pytest.raises(PoseError, match=words):
            open_recording(path, options)


def test_frames_that_go_round(write):
    with pytest.raises(PoseError, match="go round: lidar below base_link below lidar"):
        open_recording(write(static(), static(parent="lidar", child="base_link")))


def test_a_frame_below_two(write):
    """The one that is said more often counts."""
    with pytest.warns(MosWarning, match="TF has base_link twice, below map, track; track counts"):
        recording = open_recording(
            write(static(), moving(parent="track"), lambda bag: bag.transform(DRIFT, 0.0, "map", "base_link"))
        )
    np.testing.assert_allclose(recording.poses, DRIVE, atol=1e-6)


def test_tf_that_ends_early(write, capsys):
    path = write(moving(end=0.2), lambda bag: bag.transform(BASE[2], 0.2, "odom", "base_link"), static())
    with pytest.raises(PoseError, match=r"odom to base_link: has no pose at .*\(`skip_broken`\)"):
        open_recording(path)
    recording = open_recording(path, Options(skip_broken=True))
    np.testing.assert_allclose(recording.read(2).pose, DRIVE[2], atol=1e-6)
    with pytest.raises(PoseError, match="has no pose at"):
        recording.read(3)
    assert main(["run", str(path)]) == 1
    assert "(--skip-broken)" in capsys.readouterr().err


@pytest.mark.parametrize("links", [[moving()], [moving(), static(TOP)]])
def test_extrinsics_where_tf_does_not_know_the_lidar(write, links):
    """They are those of the frame that moves, and overrule what TF says."""
    numbers = " ".join(str(value) for value in MOUNT[:3].reshape(-1))
    recording = open_recording(write(*links), Options(extrinsics=numbers))
    np.testing.assert_allclose(recording.poses, DRIVE, atol=1e-6)


def odometry(bag, child="base_link"):
    for index in range(COUNT):
        bag.pose(BASE[index], 0.1 * index, child=child)


def test_odometry_of_another_frame(write):
    """TF says where the LiDAR sits in it, over a frame above both; or the user does."""
    path = write(odometry, static(MOUNT, "footprint", "lidar"), static(np.eye(4), "footprint", "base_link"))
    recording = open_recording(path)
    np.testing.assert_allclose(recording.poses, DRIVE, atol=1e-6)
    assert recording.poses_from == "/odom, lidar in base_link by TF"
    np.testing.assert_allclose(recording.other_poses()["inverse"][0], np.linalg.inv(BASE[0]) @ MOUNT, atol=1e-9)
    np.testing.assert_allclose(open_recording(path, Options(pose_topic="/odom")).poses, DRIVE, atol=1e-6)
    numbers = " ".join(str(value) for value in (MOUNT @ TOP).reshape(-1))
    recording = open_recording(path, Options(extrinsics=numbers))
    np.testing.assert_allclose(recording.poses, DRIVE @ TOP, atol=1e-6)
    assert recording.poses_from.startswith("/odom, extrinsics")


def test_transforms_are_no_clouds(write):
    with pytest.raises(SequenceError, match="has no poses on /nav"):
        open_recording(write(moving()), Options(pose_topic="/nav"))


def jumping(bag):
    """What a localiser says of base_link, less often than odometry does."""
    for index in range(COUNT):
        bag.transform((DRIFT if index < 3 else np.eye(4)) @ BASE[index], 0.1 * index, "map", "base_link")


def test_odom_counts_where_a_map_says_it_more_often(write, caplog):
    """A tree with base_link below both: odom goes smoothly, map jumps; the log says so, and `world` overrules it."""
    caplog.set_level(logging.INFO, "lidar_mos")
    path = write(static(), *[jumping] * 4, odometry_of)
    recording = open_recording(path)
    np.testing.assert_allclose(recording.poses, DRIVE, atol=1e-6)
    assert "base_link twice, below map, odom; odom counts" in caplog.text
    chosen = open_recording(path, Options(world="map"))
    np.testing.assert_allclose(chosen.poses[0], DRIFT @ DRIVE[0], atol=1e-6)
    assert "from map to lidar" in chosen.poses_from


def odometry_of(bag):
    for index in range(COUNT):
        bag.transform(BASE[index], 0.1 * index, "odom", "base_link")


def test_a_chosen_world(write, caplog):
    caplog.set_level(logging.INFO, "lidar_mos")
    path = write(moving(), static(), moving(np.array([DRIFT] * COUNT), "map", "odom"))
    np.testing.assert_allclose(open_recording(path).poses, DRIVE, atol=1e-6)
    assert "above it is map (`world`)" in caplog.text
    np.testing.assert_allclose(open_recording(path, Options(world="/map")).poses, DRIFT @ DRIVE, atol=1e-6)
    with pytest.raises(PoseError, match=r"moon \(`world`\) is not above lidar, but base_link, odom, map"):
        open_recording(path, Options(world="moon"))


def test_a_chosen_world_without_tf(write):
    path = write(lambda bag: [bag.pose(pose, 0.1 * index) for index, pose in enumerate(DRIVE)])
    with pytest.raises(PoseError, match=r"has no TF in which map could be \(`world`\)"):
        open_recording(path, Options(world="map"))
    with pytest.raises(SettingError, match="`world` is a frame of TF, and /odom"):
        open_recording(path, Options(world="map", pose_topic="/odom"))
    with pytest.raises(SettingError, match="`world` is a frame of TF"):
        Options(world="map", poses=path)

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.errors import MosWarning, PoseError
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from runtime.recordings.trajectory import poses_at
from tests.support import street


def turning(times):
    """1 rad/s about z, 10 m/s along x."""
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(times, [0, 0, 1])).as_matrix()
    poses[:, 0, 3] = 10 * np.asarray(times)
    return poses


KNOWN = np.array([0.0, 0.1, 0.2, 0.3, 1.0, 1.1])


def test_between_two_poses():
    times = np.array([0.05, 0.275, 1.01])
    found, broken = poses_at(times, KNOWN, turning(KNOWN), "p")
    np.testing.assert_allclose(found, turning(times), atol=1e-12)
    assert broken == {}


def test_a_pose_of_the_same_time_is_taken_bit_for_bit():
    poses = np.random.default_rng(1).normal(size=(6, 4, 4))
    poses[:, :3, :3] = Rotation.random(6, random_state=1).as_matrix()
    found, _ = poses_at(KNOWN + 3e-6, KNOWN, poses, "p")
    np.testing.assert_array_equal(found, poses)


def test_never_from_long_before_after_or_across_a_gap():
    found, broken = poses_at(np.array([-0.12, 0.1, 0.5, 1.3]), KNOWN, turning(KNOWN), "p.txt")
    assert list(broken) == [0, 2, 3]
    assert np.isnan(found[[0, 2, 3]]).all()
    assert broken[0] == "p.txt: has no pose at -0.120 s, the time of the scan; they go from 0.000 to 1.100 s"
    assert broken[2].endswith("none is known from 0.300 to 1.000 s")


def test_up_to_a_step_beyond_the_motion_goes_on_which_is_said():
    times = np.array([-0.1, 0.05, 1.15, 1.35])
    with pytest.warns(
        MosWarning, match=r"0.000 to 1.100 s, and the motion goes on .* scan 0 \(-0.100 s\), 2 \(1.150 s\)"
    ):
        found, broken = poses_at(times, KNOWN, turning(KNOWN), "p.txt")
    np.testing.assert_allclose(found[:3], turning(times[:3]), atol=1e-12)
    assert list(broken) == [3]
    often = np.arange(0, 0.2, 0.01)
    found, broken = poses_at(np.array([-0.02, 0.205]), often, turning(often), "p.txt")
    assert list(broken) == [0, 1]


def test_unordered_doubled_and_broken_poses():
    order = [3, 0, 1, 1, 2, 5, 4]
    poses = turning(KNOWN[order])
    poses[order.index(2)] = np.nan
    found, broken = poses_at(np.array([0.15]), KNOWN[order], poses, "p")
    np.testing.assert_allclose(found, turning([0.15]), atol=1e-12)  # of 0.1 and 0.3
    assert broken == {}
    found, broken = poses_at(np.array([0.15]), KNOWN[:0], poses[:0], "p")
    assert "no pose that can be used" in broken[0]


@pytest.fixture
def timed(folder):
    """The sequence with times from 1000 s, 0.1 s apart."""
    (folder / "times.txt").write_text("".join(f"{1000 + 0.1 * i:.6f}\n" for i in range(6)))
    (folder / "poses.txt").unlink()
    return folder


def tum(path, times, poses, header="# timestamp tx ty tz qx qy qz qw\n", separator=" "):
    rows = np.hstack([times[:, None], poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()])
    path.write_text(header + "".join(separator.join(f"{value:.12f}" for value in row) + "\n" for row in rows))


def test_a_pose_file_of_another_rate(timed):
    """Ten poses a scan, from before the first to after the last."""
    times = 999.95 + 0.01 * np.arange(80)
    tum(timed / "poses.txt", times, turning(times - 1000))
    recording = open_recording(timed, Options(frame="lidar"))
    np.testing.assert_allclose(recording.poses, turning(0.1 * np.arange(6)), atol=1e-9)
    assert set(recording.other_poses()) == {"camera", "inverse"}
    tum(timed / "poses.txt", times[:40], turning(times[:40] - 1000))
    with pytest.raises(PoseError, match=r"no pose at 1000\.400 s"):
        open_recording(timed, Options(frame="lidar"))
    recording = open_recording(timed, Options(frame="lidar", skip_broken=True))
    assert recording.read(3).pose is not None
    with pytest.raises(PoseError, match=r"no pose at 1000\.500 s"):
        recording.read(5)
    assert len(open_recording(timed, Options(frame="lidar", limit=3))) == 3


def test_poses_by_another_clock_go_line_by_line(timed):
    poses = street.drive(6)
    tum(timed / "poses.txt", 0.1 * np.arange(6), poses)
    np.testing.assert_allclose(open_recording(timed, Options(frame="lidar")).poses, poses, atol=1e-9)


@pytest.mark.parametrize(
    "header",
    [
        "timestamp,tx,ty,tz,qx,qy,qz,qw",
        "Time,X,Y,Z,q_x,q_y,q_z,q_w",
        "sec,pos_x,pos_y,pos_z,quat_x,quat_y,quat_z,quat_w",
        "stamp,pose.pose.position.x,pose.pose.position.y,pose.pose.position.z,pose.pose.orientation.x,"
        "pose.pose.orientation.y,pose.pose.orientation.z,pose.pose.orientation.w",
    ],
)
def test_tables_with_a_header(tmp_path, header):
    times, poses = 0.1 * np.arange(4), street.drive(4)
    tum(tmp_path / "p.csv", times, poses, header + "\n", ",")
    table = read_pose_table(tmp_path / "p.csv")
    np.testing.assert_allclose(table.poses, poses, atol=1e-9)
    np.testing.assert_allclose(table.times, times, atol=1e-9)


@pytest.mark.parametrize(("name", "factor"), [("timestamp_ns", 1e9), ("timestamp", 1e9), ("t", 1e6), ("time_ms", 1e3)])
def test_units_of_time(tmp_path, name, factor):
    times = 1.7e9 + 0.1 * np.arange(4)
    header = f"frame;{name};qw;qx;qy;qz;tx_m;ty_m;tz_m\n"
    (tmp_path / "p.csv").write_text(header + "".join(f"7;{time * factor:.0f};1;0;0;0;1;2;3\n" for time in times))
    table = read_pose_table(tmp_path / "p.csv")
    np.testing.assert_allclose(table.times, times, atol=1e-5)
    np.testing.assert_allclose(table.poses[0][:3, 3], [1, 2, 3])
    np.testing.assert_array_equal(table.poses[0][:3, :3], np.eye(3))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y,z,qx,qy,qz\n1,2,3,4,5,6,7\n", "no column for qw"),
        ("t,x,y,z,qx,qy,qz,qw,px\n1,2,3,4,5,6,7,8,9\n", "two columns for x: x and px"),
        ("t,x,y,z,qx,qy,qz,qw\n1,2,3,4,5,6,7\n", "line 2 has 7 numbers for the 8 columns"),
        ("t,x,y,z,qx,qy,qz,qw\n", "holds no poses"),
        ("t,x,y,z,qx,qy,qz,qw\nt,x,y,z,qx,qy,qz,qw\n", "line 2 is not made of numbers"),
    ],
)
def test_broken_tables(tmp_path, text, message):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(PoseError, match=message):
        read_pose_table(tmp_path / "p.csv")

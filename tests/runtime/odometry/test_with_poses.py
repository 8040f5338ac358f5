"""From a recording without poses to one with those that an odometry finds; what is kept of them."""

import logging

import numpy as np
import pytest

from runtime.errors import LostError, MissingPackageError, MosWarning, OutputError, PoseError, ScanError, SettingError
from runtime.odometry import odometry as odometries
from runtime.odometry.with_poses import with_poses
from runtime.recordings.deskewed import Deskewed
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.recording import Indexed, Scan

STEP = 0.5  # m
COUNT = 5


class Line:
    """An odometry that knows: always straight on. `lost`: scans at which it is."""

    name = "straight on"

    def __init__(self, lost=()):
        self.asked, self.lost = 0, list(lost)

    def locate(self, data, time, times):
        if self.asked in self.lost:
            self.lost.remove(self.asked)
            raise LostError("fog")
        self.asked += 1
        pose = np.eye(4)
        pose[0, 3] = STEP * self.asked
        return pose


class Scans(Indexed):
    """Scans of a point each. broken: numbers of those that cannot be read."""

    name, source, sensor, poses_from = "memory", "memory", None, None

    def __init__(self, broken=(), times=None):
        self.keys = tuple(f"{index:03d}" for index in range(COUNT))
        self.times, self.broken, self.point_times = np.arange(COUNT) / 10, broken, times

    def read(self, index):
        if index in self.broken:
            raise ScanError(f"{index} is broken")
        data = np.float32([[index, 1, 2, 0.5]])
        return Scan(self.keys[index], data, time=self.times[index], times=self.point_times)


def test_poses_are_found_said_and_kept(tmp_path, caplog):
    line = Line()
    with caplog.at_level(logging.INFO, "lidar_mos.recordings"):
        recording = with_poses(Scans(), line, folder=tmp_path)
    assert "memory: no poses are given: they are found by straight on" in caplog.text
    np.testing.assert_array_equal(recording.poses[:, 0, 3], STEP * np.arange(1, COUNT + 1))
    np.testing.assert_array_equal([scan.pose for scan in recording], recording.poses)
    np.testing.assert_array_equal(recording.read(2).pose, recording.poses[2])
    assert recording.poses_from == "straight on"
    for name in ("poses.txt", "poses.tum"):
        table = read_pose_table(tmp_path / name)
        np.testing.assert_array_equal(table.poses, recording.poses)
        assert table.times is None or (table.times == recording.times).all()
    assert (tmp_path / "calib.txt").read_text() == "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n"
    again = with_poses(Scans(), line, folder=tmp_path)
    np.testing.assert_array_equal(again.poses, recording.poses)
    assert line.asked == COUNT  # only the first time


@pytest.mark.parametrize("change", ["poses", "note", "scans", "odometry"])
def test_poses_of_something_else_are_found_anew(tmp_path, change):
    with_poses(Scans(), Line(), folder=tmp_path)
    recording, line = Scans(), Line()
    if change == "poses":
        (tmp_path / "poses.txt").write_text((tmp_path / "poses.txt").read_text().replace("0.5", "0.6"))
    elif change == "note":
        (tmp_path / "odometry.json").write_text("{")
    elif change == "scans":
        recording.times = recording.times + 1
    else:
        line.name = "another"
    with_poses(recording, line, folder=tmp_path)
    assert line.asked == COUNT


def test_the_poses_of_a_recording_itself_are_never_replaced(tmp_path):
    (tmp_path / "poses.txt").write_text("mine")
    line = Line()
    with pytest.raises(OutputError, match=r"holds poses\.txt that no odometry wrote; choose another place \(`out`\)"):
        with_poses(Scans(), line, folder=tmp_path)
    assert line.asked == 0
    assert [path.name for path in tmp_path.iterdir()] == ["poses.txt"]


def test_where_an_odometry_is_lost_the_next_scan_begins_anew(tmp_path):
    for line in (Line(lost=[2]), Line()):
        with pytest.warns(MosWarning, match=r"does not know how 1 scans lie to those before them: 002 \(fog\)"):
            recording = with_poses(Scans(), line, folder=tmp_path)
        assert [scan.lost for scan in recording] == ["", "", "fog", "", ""]
        assert recording.fingerprint(recording.read(2)) != recording.fingerprint(recording.read(1))
    assert line.asked == 0


def test_scans_that_cannot_be_read_have_no_pose(tmp_path):
    for line in (Line(), Line()):
        recording = with_poses(Scans(broken=(1,)), line, folder=tmp_path)
        assert np.isnan(recording.poses[1, :3]).all()
        np.testing.assert_array_equal(recording.poses[[0, 2, 3, 4], 0, 3], STEP * np.arange(1, COUNT))
        with pytest.raises(ScanError, match="1 is broken"):
            recording.read(1)
    assert len(read_pose_table(tmp_path / "poses.tum").poses) == COUNT - 1


def test_only_some_scans(tmp_path):
    recording = with_poses(Scans(), Line(), folder=tmp_path, chosen=range(1, 3))
    assert np.isfinite(recording.poses).all((1, 2)).tolist() == [False, True, True, False, False]
    assert not list(tmp_path.iterdir())
    with pytest.raises(PoseError, match="000 has no pose: straight on was not asked for it"):
        recording.read(0)


def test_points_with_times_are_deskewed_unless_they_are_not_to_be():
    times = np.float32([0.05])
    moved, left = (with_poses(Scans(times=times), Line(), deskew=deskew) for deskew in (True, False))
    assert isinstance(moved, Deskewed)
    np.testing.assert_allclose(moved.read(2).points, left.read(2).points)  # one point: its time is the middle
    np.testing.assert_allclose(moved.poses[:, 0, 3] - left.poses[:, 0, 3], STEP / 2, atol=1e-6)


def test_poses_that_are_given_are_kept():
    given = Scans()
    given.poses = np.stack([np.eye(4)] * COUNT)
    assert with_poses(given, Line()) is given


def test_what_is_no_odometry_is_refused(monkeypatch):
    with pytest.raises(SettingError, match="must be 'kiss' or have a method 'locate', not 'fast'"):
        with_poses(Scans(), "fast")
    with pytest.raises(PoseError, match=r"pose of the odometry: .* not of shape \(3, 4\)"):
        with_poses(Scans(), type("Odd", (), {"locate": lambda *_: np.eye(4)[:3]})())
    monkeypatch.setattr("runtime.compute.packages.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"pip install 'lidar-mos\[odometry\]'"):
        odometries.choose_odometry("kiss")

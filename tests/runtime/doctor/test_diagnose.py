import shutil

import numpy as np
import pytest

from bench.mounting import turned
from runtime.bundle.choice import Choice
from runtime.bundle.manifest import SensorEntry
from runtime.doctor.diagnose import examine
from runtime.recordings.calib import read_calib
from runtime.recordings.formats.registry import read_cloud
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.poses import camera_to_lidar
from runtime.recordings.recording import Options
from runtime.recordings.registry import find_recordings
from runtime.sensors.range_image import RangeImage
from tests.support import street
from tests.support.paths import KITTI

SENSOR = RangeImage(height=32, width=512, fov_up=3.0, fov_down=-25.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return street.write_kitti(tmp_path_factory.mktemp("street") / "07", 14)


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "07")


def diagnose(folder, sensor=None, **options):
    """Findings of the one recording in a folder, for a network that sees these images."""
    (found,) = find_recordings(folder)
    choose = None if sensor is None else lambda recording: Choice(SensorEntry("any", sensor), "as given")
    return examine(found, choose, Options(**options))


def levels(folder, topic=None, **options):
    """(level, text) of all findings that are not ok, or of those about `topic`."""
    findings = diagnose(folder, options.pop("sensor", SENSOR), **options)
    return [(f.level, f.text) for f in findings if (f.level != "ok" if topic is None else f.topic == topic)]


def only(folder, level, topic, *words, **options):
    """There is one finding that is not ok: of this level and topic, with these words."""
    findings = [f for f in diagnose(folder, options.pop("sensor", SENSOR), **options) if f.level != "ok"]
    assert [(f.level, f.topic) for f in findings] == [(level, topic)], findings
    for word in words:
        assert word in findings[0].text, findings[0].text


def change_scans(folder, change, every=1):
    for i, path in enumerate(sorted((folder / "velodyne").iterdir())):
        if i % every == 0:
            change(scan := read_cloud(path).data.copy())
            scan.tofile(path)


def change_poses(folder, change):
    path = folder / "poses.txt"
    street.write_poses(path, change(read_pose_table(path).poses))


def test_a_healthy_sequence(folder):
    assert levels(folder) == []
    topics = [finding.topic for finding in diagnose(folder, SENSOR)]
    seen = ["scans", "range", "remission", "ground", "field of view", "rows", "poses", "motion", "alignment"]
    assert topics == [*seen, "sensor"]
    assert "about 32 beams" in levels(folder, "rows")[0][1]


@pytest.mark.parametrize("name", ["00", "90"])
@pytest.mark.skipif(not KITTI.is_dir(), reason="needs the KITTI scans in ../shared")
def test_real_scans_are_healthy(name):
    assert levels(KITTI / name, sensor=RangeImage()) == []


def test_without_a_bundle_no_sensor_is_compared(folder):
    assert not {"field of view", "rows"} & {finding.topic for finding in diagnose(folder)}


def test_missing_folder_and_missing_files(folder):
    (folder / "poses.txt").unlink()
    only(folder, "bad", "poses", "poses.txt", "does not exist")
    for file in (folder / "velodyne").iterdir():
        file.unlink()
    only(folder, "bad", "files", "holds no")


def test_scan_cut_off(folder):
    (folder / "velodyne" / "000013.bin").write_bytes(bytes(1001))
    only(folder, "bad", "scans", "000013.bin", "no whole number")


def test_many_broken_scans_are_one_finding(folder):
    for path in (folder / "velodyne").iterdir():
        path.write_bytes(bytes(1001))
    broken = [text for level, text in levels(folder, "scans") if level == "bad"]
    assert len(broken) == 1
    assert "000000.bin" in broken[0]
    assert "13 more: 000001, 000002, 000003 and 10 more" in broken[0]


def test_one_broken_scan_does_not_keep_the_poses_from_being_checked(folder):
    change_poses(folder, np.linalg.inv)
    (folder / "velodyne" / "000005.bin").write_bytes(bytes(1001))
    assert any(level == "bad" and "T_lidar_world" in text for level, text in levels(folder, "alignment"))


def test_scan_with_few_points(folder):
    path = folder / "velodyne" / "000006.bin"
    read_cloud(path).data[::3].tofile(path)
    only(folder, "warn", "scans", "000006: less than half")


def test_empty_scans(folder):
    for path in (folder / "velodyne").iterdir():
        path.write_bytes(b"")
    assert ("bad", "no scan holds usable points") in levels(folder)


def test_missing_scan(folder):
    (folder / "velodyne" / "000008.bin").unlink()
    lines = (folder / "poses.txt").read_text().splitlines(keepends=True)
    (folder / "poses.txt").write_text("".join(lines[:8] + lines[9:]))
    found = levels(folder)
    assert found[0] == ("warn", "file names jump from 7 to 9: scans are missing there")


def test_nan(folder):
    def spoil(scan):
        scan[::100, 1] = np.nan

    change_scans(folder, spoil)
    only(folder, "warn", "points", "1.0 % hold NaN")


def test_points_at_the_origin(folder):
    def lose(scan, step=50):
        scan[::step] = 0

    change_scans(folder, lose)
    assert levels(folder) == []
    assert "2.0 % lie at the origin" in levels(folder, "points")[0][1]

    def lose_most(scan):
        scan[: 2 * len(scan) // 3] = 0

    change_scans(folder, lose_most)
    assert ("warn", "67 % lie at the origin (no return); left out and never moving") in levels(folder)


def scale(column, factor, offset=0.0):
    def change(scan):
        scan[:, column] = scan[:, column] * factor + offset

    return change


def test_remission_of_another_scale(folder):
    change_scans(folder, scale(3, 255))
    assert levels(folder) == []
    only(folder, "bad", "remission", "0..1", "divide by 255", remission_scale=1)


def test_constant_remission(folder):
    change_scans(folder, scale(3, 0))
    only(folder, "warn", "remission", "constant")


def test_negative_remission(folder):
    change_scans(folder, scale(3, 1, -0.3))
    only(folder, "warn", "remission", "needs 0..1")


def test_records_of_five_floats(folder):
    for path in (folder / "velodyne").iterdir():
        scan = read_cloud(path).data
        scan = scan[: len(scan) // 4 * 4]
        np.insert(scan, 4, np.arange(len(scan)) / len(scan), axis=1).astype(np.float32).tofile(path)
    assert any(level == "bad" and "4 float32 each" in text for level, text in levels(folder))


@pytest.mark.parametrize("name", ["000006", "000007"])
def test_an_empty_scan(folder, name):
    (folder / "velodyne" / f"{name}.bin").write_bytes(b"")
    assert ("warn", f"{name}: no points; every residual image needs its scan") in levels(folder, "scans")
    assert "about 32 beams" in levels(folder, "rows")[0][1]


def test_millimetres(folder):
    change_scans(folder, scale(slice(0, 3), 1000))
    assert any(level == "bad" and "millimetres" in text for level, text in levels(folder))


def test_sensor_with_another_field_of_view(folder):
    wide = RangeImage(height=32, width=512, fov_up=45.0, fov_down=-45.0)
    only(folder, "bad", "field of view", "only 29 % of its rows", sensor=wide)
    narrow = RangeImage(height=32, width=512, fov_up=10.0, fov_down=-10.0)
    only(folder, "warn", "field of view", "lie outside", sensor=narrow)
    apart = RangeImage(height=32, width=512, fov_up=40.0, fov_down=5.0)
    assert ("bad", "field of view") in [(f.level, f.topic) for f in diagnose(folder, apart)]


def test_sensor_with_more_or_fewer_rows(folder):
    only(folder, "warn", "rows", "about 32 beams", "64 rows", "stay empty", sensor=RangeImage())
    only(folder, "warn", "rows", "128 rows", sensor=RangeImage(height=128))
    only(folder, "warn", "rows", "16 rows", "hide each other", sensor=RangeImage(height=16))


def test_short_poses(folder):
    change_poses(folder, lambda poses: poses[:9])
    only(folder, "bad", "files", "9 poses for 14 scans")


def test_more_poses(folder):
    (folder / "velodyne" / "000000.bin").unlink()
    only(folder, "warn", "files", "line of its number (1 to 13")


def test_bad_poses(folder):
    def spoil(poses):
        poses[4, 0, 3] = np.nan
        poses[7, :3, :3] *= 1.1
        return poses

    change_poses(folder, spoil)
    only(folder, "bad", "poses", "pose 4", "NaN", "1 more")


def test_jump(folder):
    def jump(poses):
        poses[7:, 2, 3] += 5
        return poses

    change_poses(folder, jump)
    found = levels(folder)
    assert found[0][0] == "warn"
    assert "jump from 6 to 7" in found[0][1]


def test_missing_calibration(folder):
    (folder / "calib.txt").unlink()
    only(folder, "bad", "poses", "calib.txt", "`frame='lidar'`")


def test_camera_poses_taken_for_those_of_the_lidar(folder):
    only(folder, "bad", "alignment", "use `frame='camera'`", frame="lidar")
    (folder / "calib.txt").unlink()
    only(folder, "bad", "alignment", "use `frame='camera'` with its calib.txt", frame="lidar")


def test_lidar_poses_taken_for_those_of_the_camera(folder):
    change_poses(folder, lambda poses: camera_to_lidar(poses, read_calib(folder / "calib.txt")))
    only(folder, "bad", "alignment", "use `frame='lidar'`")
    assert levels(folder, frame="lidar") == []


def test_inverted_poses(folder):
    change_poses(folder, np.linalg.inv)
    only(folder, "bad", "alignment", "T_lidar_world")


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_poses_of_another_scale(folder, factor):
    def scale_positions(poses):
        poses[:, :3, 3] *= factor
        return poses

    change_poses(folder, scale_positions)
    only(folder, "bad", "alignment", "the motion that fits best")


def empty(path):
    path.write_bytes(b"")


def cut(path):
    path.write_bytes(path.read_bytes()[:101])


def fill_with_nan(path):
    np.full((9, 4), np.nan, np.float32).tofile(path)


def thin(path):
    read_cloud(path).data[::40].tofile(path)


def add_far_point(path):
    np.concatenate([read_cloud(path).data, [[3e5, 0, 0, 0.5]]]).astype(np.float32).tofile(path)


def multiply(path):
    (read_cloud(path).data * np.float32(1000)).tofile(path)


@pytest.mark.parametrize("spoil", [empty, cut, fill_with_nan, thin, add_far_point, multiply])
@pytest.mark.parametrize("scans", [(3,), (4, 8)])
def test_a_spoiled_scan_does_not_keep_the_rest_from_being_checked(folder, spoil, scans):
    for number in scans:
        spoil(folder / "velodyne" / f"{number:06d}.bin")
    assert [level for topic in ("range", "remission") for level, _ in levels(folder, topic)] == ["ok"] * 2
    assert levels(folder, "alignment")[0][0] != "bad"
    change_poses(folder, np.linalg.inv)
    assert levels(folder, "alignment")[0][0] == "bad"
    assert "T_lidar_world" in levels(folder, "alignment")[0][1]


def test_mounting(folder):
    assert levels(folder, "ground")[0][1].startswith("1.80 m below the sensor, which looks 0.0 degrees")
    down = turned(1, -5)[:3, :3].astype(np.float32)

    def tilt(scan):
        scan[:, :3] = scan[:, :3] @ down.T

    change_scans(folder, tilt)
    assert any("looks 5.0 degrees down" in text for level, text in levels(folder, "ground") if level != "ok")


def test_a_sensor_that_sits_low(tmp_path):
    pose, world = street.drive(1)[0], street.boxes()
    pose[2, 3] = 1.0
    for number in range(3):
        np.save(tmp_path / f"{number}.npy", street.scan(pose, world))
    (level, text), *_ = levels(tmp_path, "ground")
    assert (level, text.startswith("1.00 m below")) == ("warn", True)


def test_poses_that_stand_still_while_the_scans_move(folder):
    change_poses(folder, lambda poses: np.tile(np.eye(4), (len(poses), 1, 1)))
    only(folder, "bad", "alignment", "move the sensor by 0.00 m")


def test_a_parked_car_has_nothing_to_align(folder):
    first = folder / "velodyne" / "000000.bin"
    for path in (folder / "velodyne").iterdir():
        path.write_bytes(first.read_bytes())
    change_poses(folder, lambda poses: np.tile(np.eye(4), (len(poses), 1, 1)))
    assert levels(folder) == []
    assert "nothing moves" in levels(folder, "alignment")[0][1]


@pytest.mark.parametrize(("shift", "words"), [(1, "1 line earlier"), (-2, "2 lines later")])
def test_poses_out_of_step(folder, shift, words):
    change_poses(folder, lambda poses: poses[np.clip(np.arange(len(poses)) + shift, 0, len(poses) - 1)])
    assert any(level == "bad" and words in text for level, text in levels(folder, "alignment"))


def test_times(folder):
    times = 0.1 * np.arange(14)
    (folder / "times.txt").write_text("\n".join(f"{time:e}" for time in times))
    assert levels(folder) == []
    assert levels(folder, "times") == [("ok", "0.10 s a scan, no gap")]
    times[9:] += 0.3
    (folder / "times.txt").write_text("\n".join(f"{time:e}" for time in times))
    only(folder, "warn", "times", "8 to 9 (0.40 s)")
    (folder / "times.txt").write_text("\n".join(f"{0.05 * i:e}" for i in range(14)))
    only(folder, "warn", "times", "0.05 s a scan", "trained at 0.1 s")
    (folder / "times.txt").write_text("0.1 0.2")
    only(folder, "warn", "files", "2 times for 14 scans")
    (folder / "times.txt").write_text("now")
    only(folder, "warn", "files", "not made of numbers")


def test_one_scan(folder):
    for path in list((folder / "velodyne").iterdir())[1:]:
        path.unlink()
    change_poses(folder, lambda poses: poses[:1])
    only(folder, "warn", "alignment", "two scans are needed")


def test_open_ground(folder):
    def flatten(scan):
        scan[:, 2] = -1.8

    change_scans(folder, flatten)
    assert any("too few walls" in text for _, text in levels(folder, "alignment"))

import logging

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.doctor.check_alignment import check_alignment
from runtime.errors import PoseError, SequenceError
from runtime.recordings.argoverse import MOUNTS, POSES, SWEEPS, USUAL_PLACE
from runtime.recordings.recording import Options
from runtime.recordings.registry import find_recordings, open_recording
from runtime.recordings.scans import moved
from runtime.sensors.range_image import RangeImage
from tests.support import street

GEOMETRY = RangeImage(height=32, width=512)

feather = pytest.importorskip("pyarrow.feather")
pyarrow = pytest.importorskip("pyarrow")

START = 315_966_265_259_836_000  # ns
COUNT = 6


def write(path, columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pyarrow.table(columns), path)


def rows(poses):
    """Columns of positions and quaternions."""
    names = ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")
    values = np.hstack([poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()])
    return dict(zip(names, values.T, strict=True))


@pytest.fixture
def mount():
    pose = np.eye(4)
    pose[:3, 3] = USUAL_PLACE
    return pose


@pytest.fixture
def drive(tmp_path, mount):
    """A drive of `street`, with poses at twice the rate of the sweeps; points in the frame of the vehicle."""
    poses, world = street.drive(2 * COUNT), street.boxes()
    vehicle = poses @ np.linalg.inv(mount)
    folder = tmp_path / "a1b2"
    write(folder / POSES, {"timestamp_ns": START + 50_000_000 * np.arange(2 * COUNT)} | rows(vehicle))
    for i in range(COUNT):
        scan = moved(street.scan(poses[2 * i], world), mount)
        columns = dict(zip("xyz", scan.T[:3], strict=True)) | {"intensity": np.uint8(255 * scan[:, 3])}
        write(folder / SWEEPS / f"{START + 100_000_000 * i}.feather", columns)
    return folder


def test_a_drive(drive, mount, caplog):
    caplog.set_level(logging.INFO, "lidar_mos")
    for given in (drive, drive / SWEEPS, drive.parent):
        (found,) = find_recordings(given)
        assert found.path == drive
    recording = open_recording(drive)
    assert (recording.name, len(recording), recording.poses_from) == ("a1b2", COUNT, POSES)
    assert "those of two LiDARs" in caplog.text
    poses = street.drive(2 * COUNT)[::2]
    np.testing.assert_allclose(recording.poses, poses, atol=1e-9)
    scan = recording.read(2)
    np.testing.assert_allclose(scan.points, street.scan(poses[2], street.boxes())[:, :3], atol=1e-5)
    np.testing.assert_allclose(np.unique(scan.remission), [51 / 255, 102 / 255], atol=1e-6)
    assert scan.time == pytest.approx((START + 200_000_000) / 1e9, abs=1e-6)
    assert check_alignment(recording, recording.poses, GEOMETRY).level == "ok"
    assert len(open_recording(drive, Options(limit=2))) == 2
    assert open_recording(drive, Options(points_only=True)).poses is None


def test_the_calibration_of_the_drive(drive, mount):
    other = mount.copy()
    other[:3, :3] = Rotation.from_euler("z", 0.1).as_matrix()
    write(drive / MOUNTS, {"sensor_name": ["ring_front_center", "up_lidar"]} | rows(np.stack([np.eye(4), other])))
    recording = open_recording(drive)
    vehicle = street.drive(1)[0] @ np.linalg.inv(mount)
    np.testing.assert_allclose(recording.poses[0], vehicle @ other, atol=1e-9)
    assert check_alignment(recording, recording.poses, GEOMETRY).level == "ok"


def test_poses_that_end_early(drive):
    table = feather.read_table(drive / POSES)
    write(drive / POSES, {name: table[name][:9] for name in table.column_names})
    with pytest.raises(PoseError, match=r"has no pose at .* the time of the scan; they go from"):
        open_recording(drive)
    recording = open_recording(drive, Options(skip_broken=True))
    assert recording.read(4).pose is not None
    with pytest.raises(PoseError, match="no pose at"):
        recording.read(5)


def test_broken_drives(drive):
    write(drive / POSES, {"timestamp_ns": [START]})
    with pytest.raises(PoseError, match="cannot be read as poses of Argoverse 2"):
        open_recording(drive)
    for sweep in (drive / SWEEPS).iterdir():
        sweep.unlink()
    with pytest.raises(SequenceError, match="holds no sweeps"):
        open_recording(drive)


def test_two_real_sweeps(readers):
    recording = open_recording(readers / "feather")
    assert [recording.count(index) for index in range(2)] == [99229, 99466]
    scan = recording.read(0)
    expected = np.array([-1.537109375, 3.060546875, -0.322509765625]) - USUAL_PLACE
    np.testing.assert_allclose(scan.data[0], [*expected, 10 / 255], rtol=1e-6)
    assert (scan.ring.min(), scan.ring.max(), scan.ring[0]) == (0, 63, 31)
    np.testing.assert_allclose(recording.times, [315966265.259836, 315966265.360032], atol=1e-6)
    assert 0.05 < np.linalg.norm(recording.poses[1][:3, 3] - recording.poses[0][:3, 3]) < 0.08
    ground = scan.points[scan.ring < 10]
    assert np.linalg.norm(ground, axis=1).min() > 1

"""Recordings of Ouster, as the maker keeps them for tests of its own."""

import shutil

import numpy as np
import pytest

from runtime.compute import packages
from runtime.errors import MissingPackageError, MosWarning, PoseError, SequenceError
from runtime.recordings.recording import Options
from runtime.recordings.registry import find_recordings, open_recording
from tests.support import street

POINTS = Options(points_only=True)
OSF = "OS-1-128_v2.3.0_1024x10_lb_n3.osf"
PCAP, JSON = "OS-1-128_v2.3.0_1024x10_lb_n3.pcap", "OS-1-128_v2.3.0_1024x10.json"


@pytest.fixture
def sdk():
    return pytest.importorskip("ouster.sdk")


@pytest.fixture
def folder(readers):
    return readers / "ouster"


@pytest.mark.parametrize(
    ("name", "count", "rows", "width", "sensor"),
    [(OSF, 3, 128, 1024, "os1-128"), ("osf_fw_3.2_10scans.osf", 10, 8, 2048, None)],
)
def test_osf(sdk, folder, name, count, rows, width, sensor):
    """Points are those of the SDK, seen from the beams; times those of the columns."""
    recording = open_recording(folder / name, POINTS)
    assert (len(recording), recording.sensor, recording.count(0)) == (count, sensor, rows * width)
    source = sdk.open_source(str(folder / name))
    (info,) = source.sensor_info
    for index, (scan, frames) in enumerate(zip(recording, source, strict=True)):
        frame = frames[0]
        expected = sdk.core.XYZLut(info, False)(frame).reshape(-1, 3)
        seen = expected.any(1)
        expected[seen, 2] -= info.lidar_to_sensor_transform[2, 3] / 1000
        np.testing.assert_allclose(scan.points, expected, atol=1e-5)
        assert 0.3 < seen.mean() < 0.9
        np.testing.assert_array_equal(np.round(scan.remission * 255), frame.field("REFLECTIVITY").reshape(-1))
        np.testing.assert_array_equal(scan.ring, np.repeat(np.arange(rows), width))
        times = scan.times.reshape(rows, width)
        assert 0.09 < np.ptp(times) < 0.11
        np.testing.assert_allclose(times[3], 1e-9 * (frame.timestamp - frame.timestamp[0].astype(float)), atol=1e-6)
        np.testing.assert_array_equal(recording.read(index).data, scan.data)
    assert [scan.key for scan in recording.scans(count - 1)] == [f"{count - 1:06d}"]


def test_packets_give_the_scans_of_the_osf(sdk, folder):
    for one, other in zip(open_recording(folder / OSF, POINTS), open_recording(folder / PCAP, POINTS), strict=True):
        np.testing.assert_array_equal(one.data, other.data)
        np.testing.assert_array_equal(one.times, other.times)


@pytest.fixture
def posed(sdk, folder, tmp_path):
    """The first recording, as a SLAM of the maker leaves it: poses of the body within, 1 m a scan."""
    source = sdk.open_source(str(folder / OSF))
    (info,) = source.sensor_info
    sensor = np.eye(4)
    sensor[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    sensor[:3, 3] = 0.5, 0, 2
    info.sensor_to_body = sensor
    writer = sdk.osf.Writer(str(tmp_path / "posed.osf"), [info])
    for index, frames in enumerate(source):
        frames[0].body_to_world[:, 0, 3] = index + np.arange(1024) / 1024
        writer.save(0, frames[0], int(frames[0].timestamp[0]))
    writer.close()
    sensor[2, 3] += info.lidar_to_sensor_transform[2, 3] / 1000
    return tmp_path / "posed.osf", sensor


def test_poses_within(posed):
    path, mount = posed
    recording = open_recording(path, Options(deskew=False))
    assert recording.poses_from == "the file itself"
    expected = np.tile(mount, (3, 1, 1))
    expected[:, 0, 3] += np.arange(3)
    np.testing.assert_allclose(recording.poses, expected, atol=1e-9)
    np.testing.assert_array_equal(recording.read(2).pose, recording.poses[2])
    np.testing.assert_allclose(np.diff(recording.times), 0.1, atol=1e-3)
    np.testing.assert_allclose(recording.other_poses()["inverse"][1, 0, 3], mount[0, 3] - 1, atol=1e-9)


def test_poses_of_a_file(sdk, folder, tmp_path):
    with pytest.raises(PoseError, match=r"no poses: there is none within; name a file of them \(`poses`\)"):
        open_recording(folder / OSF)
    drive = street.drive(3)
    street.write_poses(tmp_path / "poses.txt", drive)
    np.testing.assert_allclose(
        open_recording(folder / OSF, Options(poses=tmp_path / "poses.txt", deskew=False)).poses, drive, atol=1e-8
    )


def test_all_of_a_folder(sdk, folder, tmp_path):
    for name in (OSF, PCAP, JSON):
        shutil.copy(folder / name, tmp_path)
    assert [one.path.name for one in find_recordings(tmp_path)] == [OSF, PCAP]


@pytest.mark.parametrize("name", ["OS-0-128_v3.0.1_1024x10.pcap", "OS-0-128_v3.0.1_1024x10_20240321_125947.pcap"])
def test_empty_files(folder, name):
    with pytest.raises(SequenceError, match="is empty, a file of 0 bytes"):
        open_recording(folder / name)


def test_a_single_packet(sdk, folder, tmp_path):
    """The JSON beside it is that of another sensor, and not taken; with one of its name there is no scan."""
    name = "OS-0-32-U1_v2.2.0_1024x10-single-packet.pcap"
    with pytest.raises(SequenceError, match="needs the metadata of its sensor, a JSON of the same name"):
        open_recording(folder / name)
    shutil.copy(folder / name, tmp_path / "a.pcap")
    shutil.copy(folder / JSON, tmp_path / "a.json")
    with pytest.raises(SequenceError, match=r"holds no whole scan, but 1 packets; is a\.json theirs"):
        open_recording(tmp_path / "a.pcap")


def test_files_that_are_cut_off(sdk, folder, tmp_path):
    (tmp_path / "a.osf").write_bytes((folder / OSF).read_bytes()[:500_000])
    with pytest.raises(SequenceError, match=r"a\.osf: (must be of one sensor|holds no whole scan)"):
        open_recording(tmp_path / "a.osf", POINTS)
    (tmp_path / "a.osf").write_bytes(b"no such file")
    with pytest.raises(SequenceError, match=r"a\.osf: cannot be read as a recording of Ouster"):
        open_recording(tmp_path / "a.osf", POINTS)
    (tmp_path / "a.pcap").write_bytes((folder / PCAP).read_bytes()[:900_000])
    shutil.copy(folder / JSON, tmp_path / "a.json")
    with pytest.warns(MosWarning, match=r"a\.pcap: is cut off, or damaged, at byte 89\d+ of 900000"):
        assert len(open_recording(tmp_path / "a.pcap", POINTS)) == 2
    (tmp_path / "a.json").write_text("{}")
    with (
        pytest.warns(MosWarning, match="is cut off"),
        pytest.raises(SequenceError, match=r"a\.pcap: cannot be read .*columns_per_frame"),
    ):
        open_recording(tmp_path / "a.pcap", POINTS)


def test_without_the_package(folder, monkeypatch):
    monkeypatch.setattr(packages, "has_package", lambda name: False)
    with pytest.raises(MissingPackageError, match=r"lidar-mos\[ouster\]"):
        open_recording(folder / OSF)

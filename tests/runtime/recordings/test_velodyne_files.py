"""Captured packets of Velodyne: those of real bags, as a network would have carried them."""

import struct

import numpy as np
import pytest

from runtime.compute import packages
from runtime.errors import MissingPackageError, MosWarning, PoseError, ScanError, SequenceError
from runtime.recordings.bag import Bag
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support import street
from tests.support.packets import write_pcap, write_vlp16

POINTS = Options(points_only=True)
SIZE = 1206  # bytes of a packet
BAGS = {"velodyne_packets_db3": "/velodyne_packets", "velodyne32_packets_db3": "/sensing/lidar/front/velodyne_packets"}


def packets_of(folder, topic):
    """Time in s and payload of each: in the messages they follow one another, each 8 bytes after its time."""
    for message in Bag(folder).messages(topic):
        start = 4 + 8 + 4 + struct.unpack_from("<I", message.data, 12)[0]
        start += -start % 4 + 4
        for at in range(start, len(message.data) - SIZE, SIZE + 8 + 2):
            seconds, nanoseconds = struct.unpack_from("<II", message.data, at)
            yield seconds + 1e-9 * nanoseconds, bytes(message.data[at + 8 : at + 8 + SIZE])


@pytest.fixture(params=BAGS)
def packets(request, readers):
    pytest.importorskip("rosbags")
    return list(packets_of(readers / "ros" / request.param, BAGS[request.param]))


@pytest.fixture
def path(packets, tmp_path):
    pytest.importorskip("velodyne_decoder")
    return write_pcap(tmp_path / "a.pcap", packets)


def test_a_capture_of_a_vlp16(tmp_path):
    pytest.importorskip("velodyne_decoder")
    recording = open_recording(write_vlp16(tmp_path / "a.pcap"), POINTS)
    assert recording.sensor == "vlp16"
    for one in recording.scans():
        np.testing.assert_allclose(np.linalg.norm(one.points, axis=1), 20, atol=0.2)


def test_turns_are_those_of_the_decoder(path, packets):
    import velodyne_decoder as velodyne

    expected = list(velodyne.read_pcap(path, velodyne.Config(cut_angle=180.0)))
    recording = open_recording(path, POINTS)
    assert recording.sensor == ("vlp16" if packets[0][1][-1] == 0x22 else "vlp32c")
    assert len(recording) == len(expected) == 5
    for index, (scan, (_, points)) in enumerate(zip(recording, expected, strict=True)):
        np.testing.assert_array_equal(scan.points, points[:, :3])
        np.testing.assert_allclose(255 * scan.remission, points[:, 3], atol=1e-4)
        np.testing.assert_array_equal(scan.times, points[:, 4])
        np.testing.assert_array_equal(scan.ring, points[:, 6])
        np.testing.assert_array_equal(recording.read(index).data, scan.data)
    limited = open_recording(path, Options(points_only=True, limit=2))
    assert len(limited) == 2
    np.testing.assert_array_equal(limited.read(1).data, recording.read(1).data)


def test_poses_are_those_of_a_file(path, tmp_path):
    with pytest.raises(PoseError, match="packets hold none; name a file"):
        open_recording(path)
    drive = street.drive(5)
    street.write_poses(tmp_path / "poses.txt", drive)
    recording = open_recording(path, Options(poses=tmp_path / "poses.txt", deskew=False))
    np.testing.assert_allclose(recording.poses, drive, atol=1e-8)
    assert np.all(np.diff(recording.times) < 0.11)
    assert recording.read(4).time == recording.times[4]


VARIANTS = {
    "big-endian": {"order": ">"},
    "Linux cooked": {"link": 113, "before": bytes(16)},
    "VLAN": {"before": bytes(12) + b"\x81\x00\x00\x05\x08\x00"},
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_other_networks(path, packets, tmp_path, variant):
    other = write_pcap(tmp_path / "b.pcap", packets, **VARIANTS[variant])
    np.testing.assert_array_equal(open_recording(other, POINTS).read(1).data, open_recording(path, POINTS).read(1).data)


def test_one_packet(packets, tmp_path):
    pytest.importorskip("velodyne_decoder")
    with pytest.raises(SequenceError, match="holds no whole scan, but 1 packets"):
        open_recording(write_pcap(tmp_path / "a.pcap", packets[:1]))


def test_cut_off(path):
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.warns(MosWarning, match=r"a\.pcap: is cut off, or damaged, at byte"):
        assert len(open_recording(path, POINTS)) == 5


def test_two_sensors(packets, tmp_path):
    pytest.importorskip("velodyne_decoder")
    one = write_pcap(tmp_path / "a.pcap", packets)
    other = write_pcap(tmp_path / "b.pcap", packets, sender=b"\xc0\xa8\x01\xca")
    one.write_bytes(one.read_bytes() + other.read_bytes()[24:])
    with pytest.raises(SequenceError, match=r"of several sensors, 192\.168\.1\.201, 192\.168\.1\.202"):
        open_recording(one)


def test_an_unknown_model(packets, tmp_path):
    pytest.importorskip("velodyne_decoder")
    unknown = [(time, payload[:-1] + b"\x01") for time, payload in packets]
    recording = open_recording(write_pcap(tmp_path / "a.pcap", unknown), POINTS)
    assert recording.sensor is None
    with pytest.raises(ScanError, match="scan 000000: cannot be decoded"):
        recording.read(0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x0a\x0d\x0d\x0a" + bytes(40), "is of the format pcapng"),
        (b"not a capture, but a text that is longer than a head", "is no pcap file"),
        (struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1), "holds no packet"),
        (struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 147), "unknown kind of network, 147"),
    ],
)
def test_no_packets(tmp_path, content, words):
    (tmp_path / "a.pcap").write_bytes(content)
    with pytest.raises(SequenceError, match=words):
        open_recording(tmp_path / "a.pcap")


def test_without_the_package(packets, tmp_path, monkeypatch):
    monkeypatch.setattr(packages, "has_package", lambda name: False)
    with pytest.raises(MissingPackageError, match=r"lidar-mos\[velodyne\]"):
        open_recording(write_pcap(tmp_path / "a.pcap", packets))

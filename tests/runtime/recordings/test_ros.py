import logging
import shutil
import tracemalloc

import numpy as np
import pytest

from runtime.commands.main import main
from runtime.compute import packages
from runtime.errors import MissingPackageError, MosWarning, ScanError, SequenceError, SettingError
from runtime.recordings.recording import Options
from runtime.recordings.registry import find_recordings, open_recording, open_recordings
from tests.support import street
from tests.support.bag_writers import KINDS, START, BagWriter, single_file

pytest.importorskip("rosbags")
POINTS = Options(points_only=True)
COUNT = 5


@pytest.fixture(scope="module")
def scans():
    drive, world = street.drive(COUNT), street.boxes()
    return [street.scan(pose, world, rows=16, columns=90) for pose in drive]


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def path(tmp_path, kind):
    return tmp_path / ("log.bag" if kind == "bag" else "log")


def same(recording, scans):
    assert len(recording) == len(scans)
    for read, scan in zip(recording, scans, strict=True):
        np.testing.assert_array_equal(read.data, scan)


def test_scans_come_back_bit_for_bit(path, kind, scans):
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index)
            bag.cloud(scan[:5], 0.1 * index, topic="/other")
    for given in (path, path.parent, single_file(path)):
        (found,) = find_recordings(given)
        recording = found.open(Options(points_only=True, topic="/points"))
        assert recording.name in ("log", "log_0")
        same(recording, scans)
    np.testing.assert_array_equal(recording.read(3).data, scans[3])
    assert [scan.key for scan in recording.scans(3)] == ["000003", "000004"]
    assert list(recording.scans(COUNT)) == []
    assert recording.count(3) == len(scans[3])
    same(found.open(Options(points_only=True, topic="/points", limit=2)), scans[:2])


def test_clouds_of_the_same_time_and_none(path, kind, scans):
    """Three messages of one time; one without any point; one of NaN."""
    written = [*scans[:3], scans[3][:0], np.full_like(scans[4], np.nan)]
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(written):
            bag.cloud(scan, 0.1 * max(0, index - 2))
    recording = open_recording(path, POINTS)
    same(recording, written)
    for index, scan in enumerate(written):
        np.testing.assert_array_equal(recording.read(index).data, scan)


LAYOUTS = {
    "padded": np.dtype(
        {"names": ["x", "y", "z", "intensity"], "formats": ["<f4"] * 4, "offsets": [0, 4, 8, 16], "itemsize": 32}
    ),
    "in another order": np.dtype(
        {
            "names": ["ring", "intensity", "z", "t", "y", "x"],
            "formats": ["<u2", "<f4", "<f4", "<u4", "<f4", "<f4"],
            "offsets": [0, 2, 6, 10, 14, 18],
            "itemsize": 22,
        }
    ),
    "big-endian": np.dtype([("x", ">f4"), ("y", ">f4"), ("z", ">f4"), ("intensity", ">f4"), ("ring", ">u2")]),
    "float64": np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("intensity", "<f8"), ("ring", "u1")]),
    "no remission": np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts(path, kind, scans, layout):
    dtype = LAYOUTS[layout]
    with BagWriter(path, kind) as bag:
        bag.cloud(scans[0][:1000], 0.0, dtype=dtype, shape=(40, 25), padding=6)
    scan = open_recording(path, POINTS).read(0)
    np.testing.assert_array_equal(scan.data, scans[0][:1000, : 3 if layout == "no remission" else 4])
    assert (scan.ring is not None) == ("ring" in dtype.names)
    assert (scan.times is not None) == ("t" in dtype.names)
    if scan.times is not None:
        np.testing.assert_allclose(scan.times, np.linspace(0, 0.1, 1000), atol=1e-6)
    if scan.ring is not None:
        np.testing.assert_array_equal(scan.ring, np.arange(1000) % 64)


def test_messages_that_do_not_fit(path, kind, scans):
    with BagWriter(path, kind) as bag:
        bag.cloud(scans[0][:100], 0.0, shape=(10, 10), lost=16)
        bag.cloud(scans[1], 0.1)
    recording = open_recording(path, POINTS)
    with pytest.raises(ScanError, match="scan 000000 of /points: is cut off: 1584 bytes for 10 rows of 10 points"):
        recording.read(0)
    np.testing.assert_array_equal(next(recording.scans(1)).data, scans[1])


def test_several_topics_are_listed(path, kind, scans, capsys):
    with BagWriter(path, kind) as bag:
        bag.cloud(scans[0], 0.0, topic="/front")
        bag.cloud(scans[0], 0.1, topic="/rear")
        bag.pose(np.eye(4), 0.0)
    with pytest.raises(
        SequenceError, match=r"several .*\(`topic`\); there are /front \(sensor_msgs.*, 1 messages\), /re"
    ):
        open_recording(path, POINTS)
    with pytest.raises(SequenceError, match=r"has no .* on /odom \(`topic`\); there are /front"):
        open_recording(path, Options(points_only=True, topic="/odom"))
    same(open_recording(path, Options(points_only=True, topic="/rear")), scans[:1])
    assert main(["doctor", str(path)]) == 1
    assert "(--topic)" in capsys.readouterr().out


def test_no_points_at_all(path, kind):
    with BagWriter(path, kind) as bag:
        bag.pose(np.eye(4), 0.0)
    with pytest.raises(SequenceError, match=r"holds no points .*there are /odom \(nav_msgs/msg/Odometry, 1 messages\)"):
        open_recording(path, POINTS)


def test_topics_are_of_bags(folder):
    with pytest.raises(SettingError, match="are of a bag of ROS"):
        open_recordings(folder, options=Options(topic="/points"))
    with pytest.raises(SettingError, match="leave out one of the two"):
        Options(poses=folder / "poses.txt", pose_topic="/odom")


def test_stamps_of_no_use(path, kind, scans, caplog):
    caplog.set_level(logging.INFO, "lidar_mos")
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index, stamp=0)
            bag.pose(np.eye(4), 0.1 * index)
    recording = open_recording(path)
    np.testing.assert_allclose(recording.times, START + 0.1 * np.arange(COUNT), atol=1e-6)
    assert "the times of recording are used" in caplog.text


def test_stamps_that_jump_back(path, kind, scans):
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index, stamp=START + 0.1 * (index % 3))
    with pytest.warns(MosWarning, match="jump back after scan 2"):
        open_recording(path, POINTS)


@pytest.fixture
def drive(path, kind, scans):
    """Odometry three times a scan, of the frame of the points."""
    poses = street.drive(COUNT)
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index)
            for part in range(3):
                bag.pose(poses[index], 0.1 * index + 0.02 * (part - 1))
    return path


def test_cut_off(drive, kind):
    """Half of it: what can be read is read, or it is refused with what may repair it."""
    file = single_file(drive)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(SequenceError, match=r"cannot be read as a bag: .*(reindex|recover)"):
        open_recording(file, POINTS)


def test_damaged_in_the_middle(tmp_path, scans):
    """The scans before the damage are there, and it is said."""
    path = tmp_path / "log.bag"
    with BagWriter(path, "bag") as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index)
    content = bytearray(path.read_bytes())
    middle = content.index(scans[3].tobytes()) - 200
    content[middle : middle + 200] = bytes(200)
    path.write_bytes(content)
    with pytest.warns(MosWarning, match="after 3 scans it cannot be read any more"):
        recording = open_recording(path, POINTS)
    assert len(recording) == 3
    for index in range(2):  # the damage begins at the end of the third
        np.testing.assert_array_equal(recording.read(index).data, scans[index])


def test_an_mcap_without_an_index(tmp_path, scans):
    with BagWriter(tmp_path / "log", "mcap") as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index)
    file = single_file(tmp_path / "log")
    content = file.read_bytes()
    summary = int.from_bytes(content[-28:-20], "little")
    file.write_bytes(content[:summary] + content[-37:-28] + bytes(20) + content[-8:])
    same(open_recording(file, POINTS), scans)


def test_a_database_with_a_journal(tmp_path, scans):
    with BagWriter(tmp_path / "log", "db3") as bag:
        bag.cloud(scans[0], 0.0)
    file = single_file(tmp_path / "log")
    file.with_name(file.name + "-wal").write_bytes(b"rest")
    with pytest.warns(MosWarning, match=r"-wal beside it holds what was written last"):
        open_recording(tmp_path / "log", POINTS)


def test_without_the_package(drive, monkeypatch):
    monkeypatch.setattr(packages, "has_package", lambda name: False)
    with pytest.raises(MissingPackageError, match=r"lidar-mos\[ros\]"):
        open_recording(drive)


def test_mos_runs_on_a_bag(drive, tmp_path, capsys):
    from tests.support.paths import BUNDLE

    assert main(["run", str(drive), "--out", str(tmp_path / "out"), "--bundle", str(BUNDLE), "--topic", "/points"]) == 0
    shown = capsys.readouterr()
    assert f"{COUNT} scans" in shown.out
    assert "the poses are those of /odom" in shown.err
    assert len(list((tmp_path / "out").rglob("*.label"))) == COUNT


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("512x10_raw.bag", r"packets of an Ouster driver \(ouster_ros/msg/PacketMsg on /os_node0.*: ouster-sdk"),
        (
            "velodyne_packets_db3",
            r"packets of a Velodyne driver \(velodyne_msgs.* on /velodyne_packets.*velodyne-decoder",
        ),
        ("velodyne32_packets_db3", r"packets of a Velodyne driver .* on /sensing/lidar/front/velodyne_packets"),
    ],
)
def test_bags_of_packets(readers, name, words):
    with pytest.raises(SequenceError, match=words):
        open_recording(readers / "ros" / name, POINTS)


def test_a_copy_of_a_database_without_its_note(readers, tmp_path):
    file = single_file(readers / "ros" / "velodyne_packets_db3")
    shutil.copy(file, tmp_path)
    with pytest.raises(SequenceError, match="packets of a Velodyne driver"):
        open_recording(tmp_path / file.name, POINTS)


def test_memory_does_not_grow_with_the_bag(path, kind):
    """2 MB of points in a scan; a chunk of a bag or two are kept."""
    scan = np.random.default_rng(1).random((120_000, 4)).astype(np.float32)
    with BagWriter(path, kind) as bag:
        for index in range(25):
            bag.cloud(scan, 0.1 * index)
    tracemalloc.start()
    for read in open_recording(path, POINTS):
        assert len(read.data) == len(scan)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 15 * scan.nbytes


@pytest.mark.parametrize(
    ("topic", "frame", "words"),
    [
        ("/sensing/lidar/concatenated/pointcloud", "lidar", "sounds as if its clouds were changed (concat)"),
        ("/points", "robot1/base_link", "the points are in robot1/base_link, which is not the frame of a LiDAR"),
    ],
)
def test_names_of_changed_clouds(tmp_path, scans, topic, frame, words):
    with BagWriter(tmp_path / "log.bag", "bag") as bag:
        bag.cloud(scans[0], 0.0, topic=topic, frame=frame)
    with pytest.warns(MosWarning) as said:
        open_recording(tmp_path / "log.bag", POINTS)
    assert words in str(said[0].message)


def test_a_topic_that_is_renamed_on_the_way(path, kind, scans):
    with BagWriter(path, kind) as bag:
        for index in range(80):
            bag.cloud(scans[0][:9], 0.1 * index, topic="/points" if index < 50 else "/velodyne_points")
    with pytest.raises(SequenceError, match=r"/points \(.*, 50 messages\), /velodyne_points \(.*, 30 messages\)"):
        open_recording(path, POINTS)
    with pytest.warns(MosWarning, match=r"of /points end 3\.0 s before the bag does; there is also /velodyne_points"):
        assert len(open_recording(path, Options(points_only=True, topic="/points"))) == 50
    with pytest.warns(MosWarning, match=r"of /velodyne_points begin 5\.0 s after the bag does"):
        open_recording(path, Options(points_only=True, topic="/velodyne_points"))
    assert len(open_recording(path, Options(points_only=True, topic="/points", limit=9))) == 9


def test_messages_of_livox(path, kind):
    from rosbags.typesys import get_types_from_msg

    name = "livox_ros_driver2/msg/CustomMsg"
    with BagWriter(path, kind) as bag:
        bag.types.register(get_types_from_msg("uint32 point_num\n", name))
        bag.write("/livox/lidar", name, bag.make(name, point_num=7), 0.0)
    with pytest.raises(
        SequenceError, match=r"messages of a Livox driver \(livox_.*CustomMsg on /livox/lidar\).*xfer_format 0"
    ):
        open_recording(path)


def test_clouds_without_points_have_labels_too(path, kind, scans, tmp_path, capsys):
    """One of NaN and one of none at all, within a drive."""
    from tests.support.paths import BUNDLE

    written = [scans[0], np.full_like(scans[1], np.nan), scans[2][:0], scans[3], scans[4]]
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(written):
            bag.cloud(scan, 0.1 * index)
            bag.pose(street.drive(COUNT)[index], 0.1 * index)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--bundle", str(BUNDLE)]) == 0
    labels = sorted((tmp_path / "out").rglob("*.label"))
    assert [file.stat().st_size for file in labels] == [4 * len(scan) for scan in written]
    assert not (np.fromfile(labels[1], np.uint32) == 251).any()


def test_two_lidars_on_one_topic(path, kind, scans):
    with BagWriter(path, kind) as bag:
        for index, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * index, frame=("left", "right")[index % 2])
    with pytest.raises(SequenceError, match="/points holds clouds of several frames, left, right"):
        open_recording(path, POINTS)

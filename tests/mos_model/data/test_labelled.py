"""Recordings to train on: what a frame holds, and what is refused before training starts."""

import shutil

import numpy as np
import pytest

from mos_model.data.dataset import SampleConfig
from mos_model.data.labelled import demand_movers, open_labelled
from runtime.errors import MosWarning, SequenceError
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.poses import camera_to_lidar
from tests.support import street
from tests.support.training import IMAGE, write_recording

CONFIG = SampleConfig(range_image=IMAGE)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    write_recording(folder / "sequences" / "00")
    write_recording(folder / "sequences" / "08", frames=8, seed=1)
    return folder


@pytest.fixture
def root(written, tmp_path):
    return shutil.copytree(written, tmp_path / "data")


def opened(root, *names):
    return open_labelled(root, names or ("00", "08"), IMAGE)


def change_labels(root, change, name="00"):
    """Rewrite every label file of a recording."""
    for file in (root / "sequences" / name / "labels").iterdir():
        change(np.fromfile(file, np.uint32)).tofile(file)


def change_scans(root, change, name="00"):
    """Rewrite every scan of a recording."""
    for file in (root / "sequences" / name / "velodyne").iterdir():
        change(np.fromfile(file, np.float32).reshape(-1, 4)).astype(np.float32).tofile(file)


def test_a_frame(root):
    (recording,) = opened(root, "00")
    scan = recording.scans.read(3)
    labels = np.fromfile(root / "sequences/00/labels/000003.label", np.uint32)
    frames = recording.history(3, CONFIG)
    assert [frame is None for frame in frames] == [True] * 5 + [False] * 4
    assert np.array_equal(frames[-1].points, scan.data[:-1])  # the point at the origin is left out
    assert frames[-1].classes.tolist() == [{252: 2, 0: 0}.get(label & 0xFFFF, 1) for label in labels[:-1].tolist()]
    assert set(frames[-1].classes) == {0, 1, 2}
    assert not frames[-2].classes.any()
    steps = np.diff([np.linalg.norm(frame.pose[:3, 3]) for frame in frames[-4:]])
    assert ((steps > 0.5) & (steps < 1.5)).all()


def test_points_are_counted_by_scan(root):
    first, second = opened(root)
    assert (len(first), len(second)) == (12, 8)
    for recording in (first, second):
        for index in (0, 7):
            labels = recording.scans.labels(index)
            assert recording.moving[index] == (labels == 252).sum() > 0
            assert recording.labelled[index] == len(labels) - 5


def test_everything_that_is_missing_is_named_at_once(root):
    for name in ("02", "03", "04"):
        write_recording(root / "sequences" / name, frames=8)
    (root / "sequences/02/labels/000001.label").unlink()
    (root / "sequences/03/poses.txt").unlink()
    shutil.rmtree(root / "sequences/04/velodyne")
    (root / "sequences/04/velodyne").mkdir()
    with pytest.raises(SequenceError) as error:
        opened(root, "00", "01", "02", "03", "04", "05")
    text = str(error.value)
    assert "has no sequence 01, 05; there are 00, 02, 03, 04, 08" in text
    assert "sequences/03/poses.txt" in text
    assert "sequences/04/velodyne" in text
    assert "sequences/00" not in text
    with pytest.raises(SequenceError, match=r"sequences/02: scan 000001 has no labels"):
        opened(root, "00", "02")


def test_labels_of_another_scan(root):
    label = root / "sequences/00/labels/000002.label"
    label.write_bytes(label.read_bytes()[:-4])
    with pytest.raises(SequenceError, match=r"000002\.label: .* are not the 4-byte labels"):
        opened(root)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda labels: (labels == 252).astype(np.uint32), "none of .* other than 0 and 1"),
        (lambda labels: (labels == 252).astype(np.float32), "float32"),
        (lambda labels: (labels == 252).astype(np.uint8), "8 bits"),
        (lambda labels: np.full_like(labels, 200), "unknown label 200"),
    ],
    ids=["0 and 1", "float32", "mask", "outside the map"],
)
def test_what_is_no_label(root, change, message):
    change_labels(root, change, "08")
    with pytest.raises(SequenceError, match=rf"training does not start:\n.*sequences/08/labels/.*{message}"):
        opened(root)


def lidar_poses(root):
    """Poses of the LiDAR beside KITTI's calibration, which makes them poses of the camera."""
    file = root / "sequences/08/poses.txt"
    street.write_poses(file, camera_to_lidar(read_pose_table(file).poses, street.TR))


@pytest.mark.parametrize(
    ("spoil", "topic", "message"),
    [
        (lambda root: change_scans(root, lambda s: s * np.float32([1, 1, 1, -90]), "08"), "remission", "negative"),
        (lambda root: change_scans(root, lambda s: s * np.float32([1e3, 1e3, 1e3, 1]), "08"), "range", "metres"),
        (lidar_poses, "alignment", "poses of the LiDAR"),
    ],
    ids=["negative remission", "millimetres", "poses of the LiDAR"],
)
def test_what_the_doctor_calls_bad_is_refused(root, spoil, topic, message):
    spoil(root)
    with pytest.raises(SequenceError, match=rf"training does not start:\n.*sequences/08: {topic}: .*{message}"):
        opened(root)


def test_remission_of_another_scale_is_read_right(root):
    """Learned from as it is, it would be a network for that scale alone."""
    change_scans(root, lambda scan: np.where([True, True, True, False], scan, np.round(scan * 500)))  # to 200
    (recording,) = opened(root, "00")
    remission = recording.history(7, CONFIG)[-1].points[:, 3]
    assert np.unique(remission).tolist() == pytest.approx([100 / 255, 200 / 255])


def test_what_is_worth_a_look_is_said_once_a_kind(root):
    for name in ("00", "08"):
        change_scans(root, lambda scan: np.where([True, True, True, False], scan, np.float32(0.25)), name)
    with pytest.warns(MosWarning) as told:
        opened(root)
    (warning,) = told
    assert "sequences/00: remission: " in str(warning.message)
    assert "1 more recording" in str(warning.message)


@pytest.mark.parametrize(("label", "message"), [(40, "labelled as moving"), (0, "has a label")])
def test_nothing_to_learn_from_is_refused(root, label, message):
    demand_movers(opened(root), "training sequences")
    for name in ("00", "08"):
        change_labels(root, lambda labels: np.full_like(labels, label), name)
    with pytest.raises(SequenceError, match=rf"training sequences \(00, 08\): no point of 20 scans .*{message}"):
        demand_movers(opened(root), "training sequences")

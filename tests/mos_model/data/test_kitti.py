"""The reader of SemanticKITTI: what it gives, and what it refuses before training starts."""

import numpy as np
import pytest

from mos_model.data import kitti
from mos_model.data.dataset import SampleConfig
from runtime.errors import SequenceError
from tests.support.paths import KITTI
from tests.support.training import SENSOR, write_recording

CONFIG = SampleConfig(SENSOR)


@pytest.fixture
def root(tmp_path):
    write_recording(tmp_path / "sequences" / "00", frames=12)
    write_recording(tmp_path / "sequences" / "08", frames=5, seed=1)
    return tmp_path


def test_a_frame(root):
    (recording,) = kitti.open_recordings(root, ["00"])
    frame = recording.frame(3, SENSOR)
    scan = np.fromfile(recording.scans.files[3], np.float32).reshape(-1, 4)
    assert np.array_equal(frame.points, scan[:-1])  # the point at the origin is left out
    assert np.array_equal(frame.classes, [2] * 120 + [1] * 175 + [0] * 4)
    assert frame.pose[:3, 3] == pytest.approx([3, 0, 0])


def test_history_begins_with_the_recording(root):
    (recording,) = kitti.open_recordings(root, ["00"])
    frames = recording.history(2, SENSOR)
    assert [frame is None for frame in frames] == [True] * 6 + [False] * 3
    assert [frame.pose[0, 3] for frame in frames[6:]] == pytest.approx([0, 1, 2])
    (sample,) = kitti.validation_frames(CONFIG, [recording]).group(2)
    assert sample.image[5:7].any(axis=(1, 2)).all()
    assert not sample.image[7:].any()


def test_an_epoch_has_every_frame_once_and_no_order_twice(root):
    recordings = kitti.open_recordings(root, ["00", "08"])
    frames = kitti.training_frames(CONFIG, recordings, seed=0, crops=1)
    assert len(frames.frames) == 17
    orders = [kitti.epoch_order(0, epoch, 17).tolist() for epoch in range(2)]
    assert sorted(orders[0]) == sorted(orders[1]) == list(range(17))
    assert orders[0] != orders[1]
    plain = kitti.validation_frames(CONFIG, recordings)
    assert np.array_equal(frames.group(17).pop().image, plain.group(orders[1][0]).pop().image)


def test_runs_of_static_frames_are_thinned():
    moving = np.array([0, 0, 0, 0, 0, 101, 300, 100, 0, 0, 0, 200, 5])
    assert kitti.thin_static(moving, every=3).tolist() == [0, 3, 5, 6, 7, 10, 11, 12]
    assert kitti.thin_static(moving, every=1).tolist() == list(range(13))
    assert kitti.thin_static(np.zeros(25), every=10).tolist() == [0, 10, 20]


def test_moving_points_are_counted_for_each_recording(tmp_path):
    for name, frames, moving in (("00", 4, 50), ("01", 2, 150), ("02", 1, 0)):
        write_recording(tmp_path / "sequences" / name, frames=frames, moving=moving)
    counts = kitti.count_moving(kitti.open_recordings(tmp_path, ["00", "01", "02"]))
    assert [c.tolist() for c in counts] == [[50] * 4, [150] * 2, [0]]


def test_published_splits():
    splits = kitti.TRAIN, kitti.VALIDATION, kitti.TEST, kitti.ROAD_TRAIN, kitti.ROAD_VALIDATION
    names = [name for split in splits for name in split]
    assert sorted(names) == [f"{i:02d}" for i in range(22)] + [str(i) for i in range(30, 42)]


def test_everything_that_is_missing_is_named_at_once(root):
    write_recording(root / "sequences" / "02", frames=3)
    write_recording(root / "sequences" / "03", frames=3)
    write_recording(root / "sequences" / "04", frames=3)
    (root / "sequences" / "02" / "labels" / "000001.label").unlink()
    (root / "sequences" / "03" / "poses.txt").unlink()
    for scan in (root / "sequences" / "04" / "velodyne").iterdir():
        scan.unlink()
    with pytest.raises(SequenceError) as error:
        kitti.open_recordings(root, ["00", "01", "02", "03", "04"])
    text = str(error.value)
    assert "sequences/01 does not exist" in text
    assert "02/labels/000001.label" in text
    assert "1 of 3 scans have no labels" in text
    assert "03/poses.txt" in text
    assert "04/velodyne" in text
    assert "sequences/00" not in text


def test_labels_of_another_scan(root):
    label = root / "sequences" / "00" / "labels" / "000002.label"
    label.write_bytes(label.read_bytes()[:-4])
    with pytest.raises(SequenceError, match=r"000002\.label.*300 points"):
        kitti.open_recordings(root, ["00"])


def test_labels_outside_the_map(root):
    label = root / "sequences" / "00" / "labels" / "000002.label"
    np.full(300, 200, np.uint32).tofile(label)
    recordings = kitti.open_recordings(root, ["00"])
    with pytest.raises(SequenceError, match=r"000002\.label.*200"):
        kitti.training_frames(CONFIG, recordings, seed=0, crops=1)


@pytest.mark.parametrize(
    "change", [np.float32, lambda labels: labels % 65536 > 250, lambda labels: labels.astype(">u4")]
)
def test_labels_of_another_type(root, change):
    """They would be unlabelled points and static ones, and the training would learn that nothing moves."""
    for label in (root / "sequences" / "00" / "labels").iterdir():
        made = change(np.fromfile(label, "<u4"))
        (made.astype("<u4") if made.dtype == bool else made).tofile(label)
    recordings = kitti.open_recordings(root, ["00"])
    with pytest.raises(SequenceError, match=r"\.label.*seems to hold"):
        kitti.training_frames(CONFIG, recordings, seed=0, crops=1)


@pytest.mark.skipif(not KITTI.is_dir(), reason="needs the KITTI excerpt of ../shared/data")
def test_real_recording():
    (recording,) = kitti.open_recordings(KITTI.parent, ["90"])
    assert len(recording.scans) == 60
    (sample,) = kitti.validation_frames(SampleConfig(), [recording]).group(20)
    assert sample.image.shape == (13, 64, 2048)
    assert (sample.labels == 2).sum() > 100
    assert (sample.labels == 0).mean() > 0.7  # outside the camera's view

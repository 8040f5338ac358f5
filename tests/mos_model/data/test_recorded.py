"""Samples of recordings: what a frame becomes, and in which order frames come."""

import pickle

import numpy as np
import pytest

from mos_model.data.dataset import SampleConfig
from mos_model.data.labelled import open_labelled
from mos_model.data.recorded import epoch_order, thin_static, training_frames, validation_frames
from runtime.sensors.range_image import RangeImage
from tests.support.paths import KITTI
from tests.support.training import IMAGE, write_recording

CONFIG = SampleConfig(range_image=IMAGE)


@pytest.fixture
def recordings(tmp_path):
    for name, frames in (("00", 12), ("08", 6)):
        write_recording(tmp_path / "sequences" / name, frames)
    return open_labelled(tmp_path, ["00", "08"], IMAGE)


def test_history_is_what_there_is(recordings):
    (sample,) = validation_frames(CONFIG, recordings[:1]).group(2)
    assert sample.image[5:7].any(axis=(1, 2)).all()
    assert not sample.image[7:].any()
    assert (sample.labels == 2).any()


def test_an_epoch_has_every_frame_once_and_no_order_twice(recordings):
    frames = training_frames(CONFIG, recordings, seed=0, crops=1)
    kept = [thin_static(recording.moving).tolist() for recording in recordings]
    assert frames.frames == tuple((r, i) for r, indices in enumerate(kept) for i in indices)
    count = len(frames.frames)
    assert 6 < count < 18
    orders = [epoch_order(0, epoch, count).tolist() for epoch in range(2)]
    assert sorted(orders[0]) == sorted(orders[1]) == list(range(count))
    assert orders[0] != orders[1]
    plain = pickle.loads(pickle.dumps(validation_frames(CONFIG, recordings)))  # as worker processes get it
    at = plain.frames.index(frames.frames[orders[1][0]])
    assert np.array_equal(frames.group(count).pop().image, plain.group(at).pop().image)


def test_runs_of_static_frames_are_thinned():
    moving = np.array([0, 0, 0, 0, 0, 101, 300, 100, 0, 0, 0, 200, 5])
    assert thin_static(moving, every=3).tolist() == [0, 3, 5, 6, 7, 10, 11, 12]
    assert thin_static(moving, every=1).tolist() == list(range(13))
    assert thin_static(np.zeros(25), every=10).tolist() == [0, 10, 20]


@pytest.mark.skipif(not KITTI.is_dir(), reason="needs the KITTI excerpt of ../shared/data")
def test_real_recording():
    recordings = open_labelled(KITTI.parent, ["90"], RangeImage())
    assert len(recordings[0]) == 60
    (sample,) = validation_frames(SampleConfig(), recordings).group(20)
    assert sample.image.shape == (13, 64, 2048)
    assert (sample.labels == 2).sum() > 100
    assert (sample.labels == 0).mean() > 0.7  # outside the camera's view

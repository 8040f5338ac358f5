"""Samples are what the runtime would give the network, with the labels of what it sees."""

from dataclasses import replace

import numpy as np
import pytest

from mos_model.data.augment import PAPER, SIM2REAL
from mos_model.data.dataset import (
    VALIDATION_STREETS,
    Frame,
    SampleConfig,
    SimulatedStreets,
    class_frequency,
    make_frame,
    make_samples,
)
from runtime.bundle.view import BirdView
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.image.inputs import InputBuilder
from runtime.sensors.registry import SENSORS
from tests.support.training import IMAGE, Patches

CONFIG = SampleConfig(range_image=IMAGE)


def history(count: int = 9, points: int = 4000) -> list[Frame]:
    """A sensor that drives through random points, a sector of which moves."""
    rng = np.random.default_rng(0)
    frames = []
    for i in range(count):
        scan = rng.uniform(-20, 20, (points, 4)).astype(np.float32)
        scan[:, 2] *= 0.25
        pose = np.eye(4)
        pose[0, 3] = 1e6 + 1.2 * i
        azimuth = np.arctan2(scan[:, 1], scan[:, 0])
        classes = np.where((azimuth > 1) & (azimuth < 1.3), 2, 1).astype(np.uint8)
        classes[azimuth < -2.5] = 0
        frames.append(Frame(scan, pose, classes))
    return frames


def test_image_is_the_runtimes_and_labels_are_those_of_the_nearest_points():
    frames = history()
    (sample,) = make_samples(frames, replace(CONFIG, points=True), np.random.default_rng(0))
    builder = InputBuilder(IMAGE, CONFIG.residual, Workers(1))
    _, built = builder.image_of([(frame.points, frame.pose) for frame in frames])
    assert np.array_equal(sample.image, built.image)
    assert np.array_equal(sample.pixel, built.pixel)
    assert np.array_equal(sample.xyz, frames[-1].points[:, :3])
    nearest = {}
    for i, (pixel, distance) in enumerate(zip(built.pixel.tolist(), built.distance.tolist(), strict=True)):
        if pixel not in nearest or distance < nearest[pixel][0]:
            nearest[pixel] = distance, frames[-1].classes[i]
    expected = np.zeros(IMAGE.height * IMAGE.width, np.uint8)
    expected[list(nearest)] = [label for _, label in nearest.values()]
    assert np.array_equal(sample.labels.reshape(-1), expected)
    assert set(expected) == {0, 1, 2}


def test_missing_history_is_zero():
    frames = history()
    (sample,) = make_samples([None, *frames[-4:]], CONFIG, np.random.default_rng(0))
    assert sample.image[5:8].any(axis=(1, 2)).all()
    assert not sample.image[8:].any()


def test_crops_are_columns_of_one_image():
    frames = history()
    config = replace(CONFIG, crop=16)
    (whole,) = make_samples(frames, CONFIG, np.random.default_rng(5))
    doubled = np.concatenate([whole.image, whole.image], axis=2)
    starts = set()
    for crop in make_samples(frames, config, np.random.default_rng(5), crops=12):
        assert crop.image.shape == (13, 16, 16)
        found = [u for u in range(64) if np.array_equal(doubled[:, :, u : u + 16], crop.image)]
        assert len(found) == 1
        labels = np.concatenate([whole.labels, whole.labels], axis=1)[:, found[0] : found[0] + 16]
        assert np.array_equal(crop.labels, labels)
        starts.add(found[0])
    assert max(starts) > 48  # over the seam too


def test_crops_of_a_view_from_above_have_no_seam():
    """Each is a part of the image, and points out of the view are in none."""
    seen = replace(CONFIG, bird=BirdView(cells=64, cell_size=0.5), points=True)
    (whole,) = make_samples(history(), seen, np.random.default_rng(5))
    assert 0 < len(whole.xyz) < 4000
    assert np.abs(whole.xyz[:, :2]).max() <= 16
    for crop in make_samples(history(), replace(seen, crop=32), np.random.default_rng(5), crops=12):
        found = [u for u in range(33) if np.array_equal(whole.image[:, :, u : u + 32], crop.image)]
        assert len(found) == 1
        assert np.array_equal(crop.labels, whole.labels[:, found[0] : found[0] + 32])


def test_crops_keep_their_points():
    frames = history()
    config = replace(CONFIG, crop=16, points=True)
    (whole,) = make_samples(frames, replace(config, crop=0), np.random.default_rng(5))
    crops = make_samples(frames, config, np.random.default_rng(5), crops=12)
    assert sum(len(crop.xyz) for crop in crops) > 100
    for crop in crops:
        nearest = np.full(16 * 16, np.inf)
        np.minimum.at(nearest, crop.pixel, np.linalg.norm(crop.xyz, axis=1))
        shown = crop.image[0].reshape(-1) * 12.32 + 12.12  # m
        np.testing.assert_allclose(shown[nearest < np.inf], nearest[nearest < np.inf], atol=1e-3)
        assert len(crop.xyz) == len(crop.classes)
        assert np.isin(crop.xyz[:, 0], whole.xyz[:, 0]).all()


def test_crops_on_movers():
    config = replace(CONFIG, crop=16, crop_on_moving=1.0)
    crops = make_samples(history(), config, np.random.default_rng(1), crops=20)
    assert all((crop.labels == 2).any() for crop in crops)


def test_augmented_labels_belong_to_augmented_points():
    """The moving sector is narrow: after any rotation, as many pixels are moving as in the scan as it was."""
    settings = replace(PAPER, share=0.0, yaw=180.0)
    share = []
    for seed in range(3):
        config = replace(CONFIG, augmentation=settings)
        (sample,) = make_samples(history(), config, np.random.default_rng(seed))
        azimuth = np.arctan2(sample.image[2] * 6.91 + 0.23, sample.image[1] * 11.47 + 10.88)[sample.labels == 2]
        assert np.ptp(np.unwrap(np.sort(azimuth))) < 0.35 or np.ptp(np.sort((azimuth + 2 * np.pi) % (2 * np.pi))) < 0.35
        share.append((sample.labels == 2).sum())
    assert np.ptp(share) < 0.3 * max(share)


def test_points_without_direction_are_left_out():
    points = np.ones((5, 4), np.float32)
    points[1, :3] = 0
    points[2, 0] = np.nan
    points[3, 1] = np.inf
    frame = make_frame(points, np.eye(4), np.arange(5, dtype=np.uint8), CONFIG)
    assert np.array_equal(frame.classes, [0, 4])
    assert frame.points.shape == (2, 4)


STREETS = SimulatedStreets(replace(CONFIG, sensor="vlp16"), seed=3, frames=2, every=3)


def test_a_street_is_a_function_of_its_number():
    streets = replace(STREETS, samples=replace(STREETS.samples, augmentation=SIM2REAL, crop=32), crops=2)
    first, again, other = streets.group(5), streets.group(5), streets.group(6)
    assert len(first) == streets.group_size == 4
    for a, b, c in zip(first, again, other, strict=True):
        assert a.image.shape == (13, 16, 32)
        assert np.array_equal(a.image, b.image)
        assert np.array_equal(a.labels, b.labels)
        assert not np.array_equal(a.image, c.image)


def test_held_out_streets_are_no_training_streets(monkeypatch):
    seen = []

    def simulate(street: int, frames: int, sensor: str) -> list:
        seen.append(street)
        return []

    monkeypatch.setattr("mos_model.simulator.simulate", simulate)
    for number in (0, 1, 10**7 - 1, 10**9):
        STREETS.group(number)
        replace(STREETS, seed=12345).group(number)
    assert max(seen) < VALIDATION_STREETS
    replace(STREETS, first_street=VALIDATION_STREETS).group(4)
    assert seen[-1] == VALIDATION_STREETS + 4


def test_class_frequency():
    source = Patches(group_size=2)
    labels = np.concatenate([s.labels.reshape(-1) for n in range(4) for s in source.group(n)])
    assert class_frequency(source, samples=8) == pytest.approx(np.bincount(labels) / len(labels))
    points = class_frequency(Patches(points=50), samples=8)
    assert points.sum() == pytest.approx(1)
    assert not np.allclose(points, class_frequency(Patches(), samples=8), atol=1e-4)


@pytest.mark.parametrize("change", [{"crop": 24}, {"crop": 128}])
def test_crops_that_cannot_be(change):
    with pytest.raises(SettingError, match="crop"):
        replace(CONFIG, **change)


def test_a_new_sensor_can_be_trained_on(contributed, monkeypatch):
    """One entry, as CONTRIBUTING says: its streets fill the rows that have beams."""
    new = contributed("runtime/sensors/acme.py").A20
    monkeypatch.setitem(SENSORS, new.name, new)
    streets = SimulatedStreets(SampleConfig(new.name, range_image=new.range_image), frames=1)
    (sample,) = streets.group(0)
    assert sample.image.shape == (13, 32, 1792)
    assert (sample.labels > 0).any(axis=1).tolist() == [True] * 20 + [False] * 12

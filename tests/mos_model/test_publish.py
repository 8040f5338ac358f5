"""Thresholds and the checkpoint that ships."""

import os
import subprocess
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

import mos_model.simulator
from mos_model.networks import checkpoint
from mos_model.networks.registry import named_config
from mos_model.publish import data_of, in_two, publish
from mos_model.simulator import simulate
from mos_model.tuning import belief
from mos_model.tuning.belief import Believed, find_belief
from mos_model.tuning.histogram import BINS, Histogram
from mos_model.tuning.thresholds import calibrate, sensor_classes
from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.manifest import BeliefNumbers, Tuned
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import find_sensor
from tests.support.paths import ROOT

HEAD = PointHeadConfig(4, (4,), (4,), None, 0.0, 0.4, "mean")


def test_best_threshold_is_that_of_a_search():
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 3, 5000).astype(np.uint8)
    probability = np.clip(rng.normal(0.3 + 0.3 * (labels == 2), 0.2), 0, 1).astype(np.float32)
    histogram = Histogram()
    histogram.add(probability[:2000], labels[:2000])
    histogram.add(probability[2000:].reshape(30, 100), labels[2000:].reshape(30, 100))
    truth, known = labels == 2, labels > 0

    def iou(threshold):
        found = (probability >= threshold) & known
        return (found & truth).sum() / ((found | truth) & known).sum()

    threshold, best = histogram.best_threshold()
    assert best == max(iou(i / BINS) for i in range(BINS)) == iou(threshold)
    assert 0.3 < threshold < 0.7
    low, less = histogram.best_threshold(slack=0.01)
    assert low == min(i / BINS for i in range(BINS) if iou(i / BINS) >= best - 0.01) < threshold
    assert best - 0.01 <= less == iou(low) < best


def test_scans_without_a_mover_count_too():
    histogram = Histogram()
    histogram.add(np.array([0.9, 0.6, 0.2], np.float32), np.array([2, 2, 1], np.uint8))
    assert histogram.best_threshold() == (pytest.approx(0.205), 1.0)
    histogram.add(np.full(5, 0.7, np.float32), np.ones(5, np.uint8))
    assert histogram.best_threshold() == (pytest.approx(0.705), 0.5)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"root": None, "train": []}, "simulated streets of mos_model.simulator"),
        ({"root": "/data/semantic-kitti", "train": ["00"]}, "recorded scans in semantic-kitti"),
        ("what was written before", "what was written before"),
    ],
)
def test_what_weights_were_trained_on_is_what_the_run_says(data, words):
    assert data_of({"data": data}) == words


def test_published_checkpoint(tmp_path):
    torch.manual_seed(0)
    config = named_config(
        "rt-head", 4, widths=(4, 4, 4, 4), point_head=HEAD, range_image=RangeImage(height=16, width=64)
    )
    network, head = config.build_image_network(), config.build_point_head()
    checkpoint.save(tmp_path / "last.pt", config, network, head, {"step": 7, "tuned": {"candidate": 0.3}})
    publish(tmp_path / "last.pt", tmp_path / "ship" / "checkpoint.pt", streets=1, name="small", licence="MIT")
    found = checkpoint.load(tmp_path / "ship" / "checkpoint.pt")
    assert found.config.name == "small"
    assert found.training["step"] == 7
    assert found.training["postprocess"] == "head"
    assert found.training["licence"] == "MIT"
    assert found.training["tuned"] == asdict(Tuned(candidate=0.3))
    pixels, points = calibrate(checkpoint.load(tmp_path / "last.pt"), 1, candidate=0.3)
    assert found.training["decisions"] == {
        "hdl64e": {
            "threshold": pixels.best_threshold()[0],
            "head_threshold": points.best_threshold()[0],
        }
    }
    assert points.counts.sum() > pixels.counts.sum() > 0
    stored = checkpoint.read(tmp_path / "ship" / "checkpoint.pt")
    assert {v.dtype for v in stored.image_net.values() if v.is_floating_point()} == {torch.float16}


def test_thresholds_are_those_of_the_sensor(monkeypatch):
    asked = set()

    def watched(seed, frames, sensor, **settings):
        asked.add(sensor)
        return simulate(seed, frames, replace(find_sensor(sensor), azimuth_steps=180), **settings)

    monkeypatch.setattr(mos_model.simulator, "simulate", watched)
    config = named_config("rt", 4, widths=(4, 4), sensor="vlp16", range_image=RangeImage(16, 64, 15, -15))
    calibrate(checkpoint.Checkpoint(config, config.build_image_network().eval(), None, {}), 1, frames=1)
    assert asked == {"vlp16"}


def test_sensors_of_about_as_many_beams_share_thresholds():
    classes = sensor_classes("hdl64e", ["vlp16", "rs16", "hdl32e", "os1-64", "vls128", "pandar40p"])
    assert classes == [("hdl64e",), ("vlp16", "rs16"), ("hdl32e", "pandar40p"), ("os1-64",), ("vls128",)]


def test_thresholds_of_belief_are_those_of_the_drives(tmp_path, monkeypatch):
    def thin(seed, frames, sensor, **settings):
        return simulate(seed, frames, replace(find_sensor(sensor), azimuth_steps=360), **settings)

    monkeypatch.setattr(belief, "simulate", thin)
    torch.manual_seed(1)
    config = named_config("rt", 4, widths=(4, 4), other_sensors=("vlp16",), range_image=RangeImage(16, 64))
    path = tmp_path / "last.pt"
    checkpoint.save(path, config, config.build_image_network())
    tuned = Tuned(belief=BeliefNumbers())
    found = find_belief(path, tuned, ("hdl64e", "vlp16"), 4)
    again = find_belief(path, tuned, ("hdl64e", "vlp16"), 4)
    for one, other in zip(found, again, strict=True):
        assert np.array_equal(one.counts, other.counts)
    assert (found.online.counts.sum(0) > 0).any()
    assert (found.online.counts != found.delayed.counts).any()
    one += other
    assert np.array_equal(one.counts, 2 * other.counts)


@pytest.mark.parametrize(
    ("arguments", "code"), [([], 1), (["--streets", "0"], 2), (["--postprocess", "best"], 2), (["--frobnicate"], 2)]
)
def test_failures_are_lines(arguments, code, tmp_path):
    """As a module, which has no other command around it."""
    command = [sys.executable, "-m", "mos_model.publish", "absent.pt", "out.pt", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == code
    assert "Traceback" not in done.stderr
    assert code == 2 or done.stderr == "publish: absent.pt: there is no such checkpoint\n"


def test_sensors_of_few_beams_have_a_threshold_of_their_own():
    def believed(probability):
        one = Believed(Histogram(), Histogram())
        for histogram in one:
            histogram.add(np.array([probability, 0.1], np.float32), np.array([2, 1], np.uint8))
        return one

    classes = [("hdl64e",), ("vlp16", "rs16"), ("hdl32e",)]
    (few, of_few), (others, of_others) = in_two(classes, [believed(0.9), believed(0.5), believed(0.7)])
    assert (few, others) == (["vlp16", "rs16"], ["hdl64e", "hdl32e"])
    assert [of_few.online.counts.sum(), of_others.online.counts.sum(), of_others.delayed.counts.sum()] == [2, 4, 4]
    assert [names for names, _ in in_two(classes[:1], [believed(0.9)])] == [["hdl64e"]]

"""The INT8 export from end to end: what it writes, what it says, and what it refuses."""

import dataclasses
import functools
import json
import shutil

import numpy as np
import pytest

import mos_model.simulator
from export.bundle import parity
from export.convert import export_checkpoint
from export.int8 import quantise as int8
from export.int8.judge import Loss
from export.int8.quantise import Settings, choose_floats
from export.to_onnx import export
from mos_model.networks.checkpoint import save
from mos_model.simulator import simulate
from runtime.bundle.loading import load_bundle
from runtime.commands.handler import run_alone
from runtime.errors import QuantisationError, SettingError
from runtime.image.image_net import ImageNet
from runtime.runner import MosRunner
from runtime.sensors.registry import SENSORS
from tests.support.make_tiny import random_network, tiny_config

THIN = dataclasses.replace(SENSORS["hdl64e"], azimuth_steps=150)
QUICK = Settings(streets=1, judging=1, threads=1)


@pytest.fixture(scope="module", autouse=True)
def thin_scans():
    """A fraction of the sensor's columns."""

    def thin(*arguments, sensor=None, **settings):
        return simulate(*arguments, sensor=THIN, **settings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parity, "simulate", lambda seed, frames, _, **more: simulate(seed, frames, THIN, **more))
        patch.setattr(mos_model.simulator, "simulate", thin)
        yield


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """The tiny image network alone."""
    path = tmp_path_factory.mktemp("checkpoint") / "checkpoint.pt"
    config = dataclasses.replace(tiny_config(), point_head=None)
    save(path, config, random_network(config)[0], None, {"trained": False}, half=True)
    return path


@pytest.fixture(scope="module")
def first(checkpoint, tmp_path_factory):
    """It in INT8."""
    out = tmp_path_factory.mktemp("int8") / "bundle"
    return export_checkpoint(checkpoint, out, precision="int8", int8=QUICK).bundle


def test_both_networks_are_in_the_bundle_and_nearly_agree(first):
    assert set(first.manifest.files) == {"image_net.onnx", "image_net_int8.onnx"}
    assert first.manifest.files["image_net_int8.onnx"].precision == "int8"
    image = np.random.default_rng(0).normal(size=(13, 64, 256)).astype(np.float32)
    real, whole = (ImageNet.of(first, precision, threads=1).run(image) for precision in ("float32", "int8"))
    assert 1e-6 < np.abs(real[0] - whole[0]).mean() < 0.02


def test_the_manifest_says_what_was_measured(first):
    record = first.manifest.accuracy["int8"]
    assert record["calibration"] == "1 simulated streets from 16000000"
    assert record["judged_on"] == "1 simulated streets from 17000000, pixels"
    assert 0 < record["probability_difference"] < 0.02
    assert record["float_layers"] == []
    assert abs(record["added_to_moving_logit"]) < 0.5
    assert record["integer_layers"] > 50
    assert "untrained" in record["note"]
    assert "iou_int8" not in record


def test_the_same_checkpoint_gives_the_same_bytes(first, checkpoint, tmp_path):
    again = export_checkpoint(checkpoint, tmp_path / "again", precision="int8", int8=QUICK).bundle
    for name in ("image_net_int8.onnx", "manifest.json"):
        assert (again.path / name).read_bytes() == (first.path / name).read_bytes()


def test_trained_weights_are_judged_by_iou(checkpoint, tmp_path):
    done = export_checkpoint(
        checkpoint,
        tmp_path / "bundle",
        trained=True,
        precision="int8",
        int8=dataclasses.replace(QUICK, limit=101),  # random weights may lose anything
    )
    record = done.bundle.manifest.accuracy["int8"]
    assert record["limit"] == 101
    assert 0 <= record["iou_float"] <= 100
    assert 0 <= record["iou_int8"] <= 100


def test_a_network_that_loses_too_much_is_refused_and_nothing_written(checkpoint, monkeypatch, tmp_path):
    def refuse(prepared, judge, limit, finished):
        raise QuantisationError(f"{len(prepared.layers) > 50}, {limit}, {judge.loss(finished(())).difference > 0}")

    monkeypatch.setattr(int8, "choose_floats", refuse)
    with pytest.raises(QuantisationError, match=r"True, 0\.5, True"):
        export_checkpoint(checkpoint, tmp_path / "bundle", trained=True, precision="int8", int8=QUICK)
    assert list(tmp_path.iterdir()) == []


class Fake:
    """Layers a to h, of which c and f each lose 2 points where they are in integers."""

    layers = dict.fromkeys("abcdefgh")

    def model(self, floats=()):
        return {"a": 0, "b": 0, "c": 2, "d": 0, "e": 0, "f": 3, "g": 0, "h": 0}.keys() - set(floats)


class FakeJudge:
    def quick(self):
        return self

    def loss(self, integers):
        lost = sum({"c": 2.0, "f": 3.0}.get(layer, 0.0) for layer in integers)
        return Loss(60.0, 60.0 - lost, lost / 100)


@pytest.mark.parametrize(("limit", "floats"), [(6, ()), (2.5, ("f",)), (0.5, ("f", "c"))])
def test_the_worst_layers_stay_in_float_and_no_more_than_needed(limit, floats):
    assert choose_floats(Fake(), FakeJudge(), limit, Fake().model) == floats


def test_the_error_names_the_layers_that_lose_most():
    with pytest.raises(QuantisationError, match=r"f \(3\.0e-02\), c \(2\.0e-02\)"):
        choose_floats(Fake(), FakeJudge(), -1, Fake().model)


def test_a_runner_takes_int8_and_says_so(first, caplog):
    caplog.set_level("INFO", "lidar_mos")
    runner = MosRunner(first.path, threads=1, precision="int8", postprocess="knn")
    assert runner.precision == "int8"
    assert "image network in int8: as asked for" in caplog.text
    scan = np.random.default_rng(0).uniform(-20, 20, (500, 4)).astype(np.float32)
    assert runner(scan, np.eye(4)).moving.shape == (500,)


def test_the_command(checkpoint, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(int8, "CALIBRATION_STREETS", 20_000_000)
    monkeypatch.setattr(Settings, "__init__", functools.partialmethod(Settings.__init__, streets=1, judging=1))
    command = ["--checkpoint", str(checkpoint), "--out", str(tmp_path / "bundle"), "--threads", "1"]
    assert run_alone(export, "mos export", [*command, "--precision", "int8"]) == 0
    said = capsys.readouterr().out
    assert "int8     mean difference of a probability" in said
    assert "image_net_int8.onnx" in said
    manifest = json.loads((tmp_path / "bundle" / "manifest.json").read_text())
    assert manifest["accuracy"]["int8"]["calibration"].endswith("20000000")
    assert load_bundle(tmp_path / "bundle").image_net("int8").is_file()


def test_a_bundle_keeps_its_integers_unless_told_otherwise(first, checkpoint, tmp_path, monkeypatch):
    monkeypatch.setattr(Settings, "__init__", functools.partialmethod(Settings.__init__, streets=1, judging=1))
    out = shutil.copytree(first.path, tmp_path / "kept")
    again = ["--checkpoint", str(checkpoint), "--out", str(out)]
    assert run_alone(export, "mos export", again) == 0
    assert (out / "image_net_int8.onnx").is_file()
    assert run_alone(export, "mos export", [*again, "--precision", "float32"]) == 0
    assert not (out / "image_net_int8.onnx").exists()
    assert run_alone(export, "mos export", again) == 0
    assert not (out / "image_net_int8.onnx").exists()


def test_settings_that_cannot_be_are_errors(checkpoint, tmp_path):
    with pytest.raises(SettingError, match="float32 or int8"):
        export_checkpoint(checkpoint, tmp_path / "bundle", precision="int4")
    with pytest.raises(SettingError, match="for precision 'int8'"):
        export_checkpoint(checkpoint, tmp_path / "bundle", int8=QUICK)

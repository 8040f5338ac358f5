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
from export.graph.image_graph import Outputs
from export.int8 import quantise as int8
from export.int8.judge import LARGEST_SHIFT, Balance, Judge, Loss
from export.int8.prepare import prepare
from export.int8.quantise import Settings, choose_floats
from export.int8.scenes import Scene, recorded
from export.to_onnx import export
from mos_model.networks.checkpoint import save
from mos_model.simulator import simulate
from mos_model.simulator.write import write_dataset
from runtime.bundle.loading import load_bundle
from runtime.bundle.residual import Residual
from runtime.commands.handler import run_alone
from runtime.errors import MosWarning, QuantisationError, ScanError, SequenceError, SettingError
from runtime.image.image_net import ImageNet
from runtime.runner import MosRunner
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import SENSORS
from tests.support.make_tiny import random_network, tiny_config
from tests.support.paths import ROOT

TINY = ROOT / "tests" / "data" / "tiny"
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


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """Ten scans of a street."""
    folder = tmp_path_factory.mktemp("street")
    write_dataset(folder, 1, 10, seed=3, sensor=dataclasses.replace(SENSORS["hdl64e"], azimuth_steps=600))
    return folder / "sequences" / "00"


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


def test_the_judge_sees_no_loss_of_a_model_against_itself():
    model = (TINY / "bundle" / "image_net.onnx").read_bytes()
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 3, (64, 256)).astype(np.uint8)
    scenes = [Scene(rng.normal(size=(1, 13, 64, 256)).astype(np.float32), labels)]
    loss = Judge(model, scenes, 0.05, 1).loss(model)
    assert loss.points == 0
    assert loss.difference == 0
    assert loss.before > 0


@pytest.mark.parametrize(("moved", "lacking"), [(-0.3, 0.3), (0.0, 0.0), (0.2, -0.2), (3.0, -LARGEST_SHIFT)])
def test_the_balance_finds_what_a_logit_was_moved_by(moved, lacking):
    config = dataclasses.replace(tiny_config(), point_head=None)
    shape = (1, 13, 64, 256)
    images = [np.random.default_rng(i).normal(size=shape).astype(np.float32) for i in range(2)]
    network = Outputs(random_network(config)[0].eval())
    prepared = prepare(network, shape, images)
    balance = Balance(prepared.model(), images, 1)
    assert balance.lacking(prepared.model(moving=moved)) == pytest.approx(lacking, abs=0.01)


def test_own_scans_calibrate(street):
    images = recorded(street, RangeImage(width=256), Residual(), count=2)
    assert [image.shape for image in images] == [(1, 13, 64, 256)] * 2
    assert all(image[:, :5].any() and image[:, 5:].any() for image in images)
    assert not np.array_equal(*images)


def spoilt(street, folder, change):
    """A copy of the street whose scans went through `change`."""
    (folder / "velodyne").mkdir(parents=True)
    for name in ("calib.txt", "poses.txt"):
        (folder / name).write_bytes((street / name).read_bytes())
    for scan in sorted((street / "velodyne").iterdir()):
        points = np.fromfile(scan, np.float32).reshape(-1, 4)
        change(points).astype(np.float32).tofile(folder / "velodyne" / scan.name)
    return folder


def tilted(points):
    """Seen by a sensor that looks up: no elevation fits."""
    points[:, 2] = np.abs(points[:, 2]) + np.hypot(points[:, 0], points[:, 1])
    return points


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (np.zeros_like, "no scan holds a usable point"),
        (lambda points: points * np.float32([1000, 1000, 1000, 1]), "metres"),
        (tilted, "field of view"),
        (lambda points: points * np.float32([1, 1, 1, 255]), "remission"),
    ],
)
def test_calibration_data_that_do_not_fit_are_refused(street, tmp_path, change, message):
    with pytest.raises(ScanError, match=message):
        recorded(spoilt(street, tmp_path / "bad", change), RangeImage(), Residual())


def test_other_rows_are_warned_of(street, tmp_path):
    with pytest.warns(MosWarning, match="rows"):
        recorded(street, RangeImage(height=128, width=256), Residual(), count=1)


def test_no_or_too_few_scans_are_an_error(street, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(SequenceError, match="no"):
        recorded(tmp_path / "empty", RangeImage(), Residual())
    short = spoilt(street, tmp_path / "short", lambda points: points)
    for scan in sorted((short / "velodyne").iterdir())[8:]:
        scan.unlink()
    with pytest.raises(SequenceError, match="at least 9"):
        recorded(short, RangeImage(), Residual())


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

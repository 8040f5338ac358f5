"""From a checkpoint to a bundle: whole, equal to PyTorch, the same bytes each time, or nothing."""

import dataclasses
import json

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper

from export import convert
from export.bundle import head_weights, parity, write
from export.convert import export_checkpoint
from mos_model.networks.checkpoint import load, save
from mos_model.simulator import simulate
from runtime.bundle.loading import load_bundle
from runtime.bundle.manifest import Tuned
from runtime.errors import BundleError, CheckpointError, OutputError, ParityError, SettingError
from runtime.runner import MosRunner
from runtime.sensors.registry import SENSORS
from tests.support.disk import full_disk
from tests.support.make_tiny import random_network, tiny_config
from tests.support.paths import ROOT

TINY = ROOT / "tests" / "data" / "tiny"


@pytest.fixture(scope="module", autouse=True)
def thin_scans():
    """A tenth of the sensor's columns: the comparison is quick. The script's test takes full scans."""
    sensor = dataclasses.replace(SENSORS["hdl64e"], azimuth_steps=200)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parity, "simulate", lambda seed, frames, _, **more: simulate(seed, frames, sensor, **more))
        yield


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """What an export of the tiny checkpoint did, with everything that a bundle can hold."""
    return export_checkpoint(TINY / "checkpoint.pt", tmp_path_factory.mktemp("first") / "bundle", point_head_onnx=True)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_bundle_agrees_and_says_so(first):
    manifest = first.bundle.manifest
    assert 0 < first.parity.worst() < 1e-5
    assert manifest.parity["image_net"] >= first.parity.image_net
    assert manifest.parity["point_head"] >= first.parity.point_head
    assert manifest.parity["point_head_onnx"] >= first.parity.point_head_onnx > 0
    assert manifest.parity["limit"] == 1e-4
    assert manifest.weights["trained"] is False
    assert manifest.model == tiny_config().to_dict()
    assert {entry.precision for entry in manifest.files.values()} == {"float16"}
    files = {"manifest.json", "image_net.onnx", "point_head.npz", "point_head.onnx"}
    assert set(contents(first.bundle.path)) == files


def test_the_same_checkpoint_gives_the_same_bytes(first, tmp_path):
    again = export_checkpoint(TINY / "checkpoint.pt", tmp_path / "again", point_head_onnx=True)
    assert contents(first.bundle.path) == contents(again.bundle.path)


def test_the_committed_bundle_is_that_of_the_committed_checkpoint(first):
    """The same graphs and weights; what is computed of them in float32 may round otherwise on another processor."""
    committed, made = load_bundle(TINY / "bundle").manifest, first.bundle.manifest
    assert committed.model == made.model
    assert committed.weights == made.weights
    assert (TINY / "bundle" / "point_head.npz").read_bytes() == (first.bundle.path / "point_head.npz").read_bytes()
    for name in ("image_net.onnx", "point_head.onnx"):
        graphs = [onnx.load(folder / name).graph for folder in (TINY / "bundle", first.bundle.path)]
        theirs, ours = ({value.name: numpy_helper.to_array(value) for value in g.initializer} for g in graphs)
        assert list(theirs) == list(ours), name
        for key in ours:
            np.testing.assert_allclose(theirs[key], ours[key], rtol=1e-5, atol=1e-8, err_msg=f"{name}: {key}")
        for graph in graphs:
            graph.ClearField("initializer")
        assert graphs[0] == graphs[1], name


def test_what_was_calibrated_with_the_weights_is_in_the_manifest(tmp_path):
    config = dataclasses.replace(tiny_config(), point_head=None)
    record = {"trained": False, "threshold": 0.4, "tuned": {"candidate": 0.3, "jump": 4}}
    save(tmp_path / "checkpoint.pt", config, random_network(config)[0], None, record, half=True)
    manifest = export_checkpoint(tmp_path / "checkpoint.pt", tmp_path / "bundle").bundle.manifest
    assert manifest.tuned == Tuned(candidate=0.3, jump=4)
    assert manifest.sensor.decision.threshold == 0.4
    assert "tuned" not in manifest.weights["training"]
    save(tmp_path / "checkpoint.pt", config, random_network(config)[0], None, {"tuned": {"candidat": 0.3}})
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt: tuned: unknown entry candidat"):
        export_checkpoint(tmp_path / "checkpoint.pt", tmp_path / "other")


def test_the_bundle_runs(first):
    runner = MosRunner(first.bundle.path, threads=1)
    scan = np.random.default_rng(0).uniform(-20, 20, (500, 4)).astype(np.float32)
    assert runner(scan, np.eye(4)).moving.shape == (500,)


def test_make_tiny_makes_the_committed_weights():
    stored = load(TINY / "checkpoint.pt")
    for found, made in zip((stored.image_net, stored.point_head), random_network(tiny_config()), strict=True):
        for key, value in made.state_dict().items():
            torch.testing.assert_close(found.state_dict()[key], value, atol=1e-3, rtol=1e-3)


def test_a_bundle_that_disagrees_is_not_kept(monkeypatch, tmp_path):
    real = head_weights.write_point_head

    def spoilt(path, head, config, half):
        real(path, head, config, half)
        with np.load(path) as stored:
            arrays = dict(stored)
        arrays["classifier.bias"] = arrays["classifier.bias"] + np.float32([0, 0, 0.1])
        np.savez(path, **arrays)

    monkeypatch.setattr(convert, "write_point_head", spoilt)
    with pytest.raises(ParityError, match="differs from PyTorch"):
        export_checkpoint(TINY / "checkpoint.pt", tmp_path / "bundle")
    assert list(tmp_path.iterdir()) == []


def test_an_onnx_point_head_that_disagrees_is_not_kept(monkeypatch, tmp_path):
    real = convert.head_bytes

    def spoilt(arrays, config):
        return real(arrays | {"classifier.bias": arrays["classifier.bias"] + np.float32([0, 0, 0.1])}, config)

    monkeypatch.setattr(convert, "head_bytes", spoilt)
    with pytest.raises(ParityError, match="as ONNX graph"):
        export_checkpoint(TINY / "checkpoint.pt", tmp_path / "bundle", point_head_onnx=True)
    assert list(tmp_path.iterdir()) == []


def test_the_onnx_point_head_is_optional(tmp_path):
    made = export_checkpoint(TINY / "checkpoint.pt", tmp_path / "bundle")
    assert set(made.bundle.manifest.files) == {"image_net.onnx", "point_head.npz"}
    assert made.parity.point_head_onnx is None
    assert "point_head_onnx" not in made.bundle.manifest.parity


def test_no_onnx_point_head_without_a_point_head(tmp_path):
    config = dataclasses.replace(tiny_config(), point_head=None)
    image_net, _ = random_network(config)
    save(tmp_path / "checkpoint.pt", config, image_net, None, {"trained": False}, half=True)
    with pytest.raises(SettingError, match="has no point head"):
        export_checkpoint(tmp_path / "checkpoint.pt", tmp_path / "bundle", point_head_onnx=True)


def test_a_failed_export_leaves_the_earlier_bundle(monkeypatch, tmp_path):
    out = tmp_path / "bundle"
    with write.replacing_bundle(out) as folder:
        (folder / "manifest.json").write_text("earlier")
    monkeypatch.setattr(convert, "check_parity", lambda *_: (_ for _ in ()).throw(ParityError("no")))
    with pytest.raises(ParityError):
        export_checkpoint(TINY / "checkpoint.pt", out)
    assert contents(out) == {"manifest.json": b"earlier"}
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"weights": "int4"}, SettingError, "stored as float16 or float32"),
        ({"height": 63}, SettingError, "multiple of 16"),
        ({"height": 0}, SettingError, "multiple of 16"),
        ({"width": 0}, SettingError, "multiple of 16"),
        ({"network": "v1"}, CheckpointError, "leave out v1"),
    ],
)
def test_settings_that_cannot_be_are_errors(tmp_path, settings, error, message):
    with pytest.raises(error, match=message):
        export_checkpoint(TINY / "checkpoint.pt", tmp_path / "bundle", **settings)
    assert list(tmp_path.iterdir()) == []


def test_other_files_of_a_bundle_are_kept(tmp_path):
    out = tmp_path / "bundle"
    out.mkdir()
    (out / "checkpoint.pt").write_bytes(b"weights")
    (out / "README.md").write_text("card")
    for content in ("one", "two"):
        with write.replacing_bundle(out) as folder:
            (folder / "manifest.json").write_text(content)
        assert contents(out) == {"manifest.json": content.encode(), "checkpoint.pt": b"weights", "README.md": b"card"}


def test_a_folder_that_is_no_bundle_is_not_replaced(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_bytes(b"cat")
    (tmp_path / "file").write_text("x")
    for name in ("photos", "file"):
        with pytest.raises(BundleError, match="is no bundle"), write.replacing_bundle(tmp_path / name):
            pass
    assert (tmp_path / "photos" / "cat.jpg").read_bytes() == b"cat"


def test_a_full_disk_leaves_the_earlier_bundle(tmp_path):
    out = tmp_path / "bundle"
    with write.replacing_bundle(out) as folder:
        (folder / "manifest.json").write_text("earlier")
    with full_disk(3), pytest.raises(OutputError, match="File too large"), write.replacing_bundle(out) as folder:
        (folder / "manifest.json").write_text("later")
    assert contents(out) == {"manifest.json": b"earlier"}
    assert list(tmp_path.iterdir()) == [out]


def test_weights_beyond_float16_are_an_error():
    image_net, _ = random_network(tiny_config())
    image_net.context[0].shortcut.weight.data[0] = 1e6
    with pytest.raises(CheckpointError, match=r"context\.0\.shortcut\.weight; keep float32"):
        write.rounded_to_half(image_net, "test")


@pytest.mark.parametrize(("value", "rounded"), [(0.0, 0.0), (1.2e-7, 2e-7), (9.5e-7, 1e-6), (3e-6, 3e-6)])
def test_figures_are_rounded_up(value, rounded):
    assert parity._rounded_up(value) == pytest.approx(rounded)


def test_values_that_are_not_finite_never_agree():
    assert parity._difference(np.float32([np.nan]), np.float32([0])) == float("inf")
    assert not parity.Parity(float("nan"), 0.0, None, 1).worst() <= parity.LIMIT


def test_manifests_hold_plain_values_only():
    values = {"step": 3, "scores": [0.5, torch.zeros(1)], "average": torch.zeros(1), 1: None, "best": float("-inf")}
    kept = write.plain(values)
    assert kept == {"step": 3, "scores": [0.5], "1": None}
    json.dumps(kept)

"""Bundles: the tiny one loads, and everything that can be wrong with one is said."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from runtime import MosRunner
from runtime.bundle import loading as module
from runtime.bundle.loading import default_bundle_path, load_bundle
from runtime.bundle.manifest import Decision, SensorEntry, Tuned, parse_manifest
from runtime.bundle.residual import Residual
from runtime.errors import BundleError
from runtime.head.weights import checked
from runtime.sensors.range_image import RangeImage
from runtime.sensors.sensor import UNKNOWN_REACH
from tests.support.paths import BUNDLE, DATA


@pytest.fixture
def folder(tmp_path):
    """A copy of the tiny bundle, to be spoilt."""
    return Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))


def edit(folder, change):
    """Let `change` work on the manifest's JSON."""
    path = folder / "manifest.json"
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))
    return folder


def test_the_tiny_bundle_loads():
    bundle = load_bundle(BUNDLE)
    manifest = bundle.manifest
    assert (manifest.name, manifest.sensor.range_image.height, manifest.sensor.range_image.width) == ("tiny", 64, 256)
    assert manifest.classes == ("unlabelled", "static", "moving")
    assert manifest.residual.lags == tuple(range(1, 9))
    assert manifest.weights["trained"] is False
    assert manifest.parity["image_net"] < manifest.parity["limit"] == 1e-4
    assert bundle.image_net() == bundle.image_net("float32") == BUNDLE / "image_net.onnx"


def test_weights_of_the_point_head_fit_and_carry_their_scale():
    bundle = load_bundle(BUNDLE)
    weights = bundle.point_head()
    assert set(checked(weights, bundle.manifest.point_head)) == set(weights)
    with np.load(BUNDLE / "point_head.npz") as stored:
        assert stored["stem.weight"].dtype == np.float16
        np.testing.assert_array_equal(
            weights["stem.weight"], stored["stem.weight"].astype(np.float32) * stored["stem.scale"]
        )


def test_a_precision_that_is_not_there_is_an_error():
    with pytest.raises(BundleError, match="no image network of precision 'int8', only float32"):
        load_bundle(BUNDLE).image_net("int8")


@pytest.mark.parametrize("name", ["image_net.onnx", "point_head.npz", "manifest.json"])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(BundleError, match=f"{name}: cannot be read"):
        load_bundle(folder)


@pytest.mark.parametrize("name", ["image_net.onnx", "point_head.npz"])
@pytest.mark.parametrize("cut", [False, True])
def test_an_altered_file_is_named(folder, name, cut):
    data = bytearray((folder / name).read_bytes())
    data[len(data) // 2] ^= 1
    (folder / name).write_bytes(data[:-1] if cut else data)
    with pytest.raises(BundleError, match=f"{name}: is not the file that the manifest describes"):
        load_bundle(folder)


def test_a_network_that_the_manifest_does_not_list_is_an_error(folder):
    (folder / "image_net_int8.onnx").write_bytes(b"network")
    with pytest.raises(BundleError, match=r"image_net_int8.onnx: is not in the manifest"):
        load_bundle(folder)


def test_other_files_may_lie_beside(folder):
    (folder / "README.md").write_text("model card")
    load_bundle(folder)


def test_no_folder_and_a_file_are_no_bundle(tmp_path):
    with pytest.raises(BundleError, match="there is no bundle here"):
        load_bundle(tmp_path / "none")
    (tmp_path / "file").write_text("x")
    with pytest.raises(BundleError, match="there is no bundle here"):
        load_bundle(tmp_path / "file")


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"name": "x"}', '{"format": "1"}', '{"format": true}'])
def test_a_manifest_that_is_none_is_an_error(folder, text):
    (folder / "manifest.json").write_text(text)
    with pytest.raises(BundleError, match=r"manifest\.json"):
        load_bundle(folder)


def test_formats_of_other_versions_say_what_to_do(folder):
    with pytest.raises(BundleError, match=r"format 3, .* update lidar-mos"):
        load_bundle(edit(folder, lambda values: values.update(format=3, unheard_of=1)))
    with pytest.raises(BundleError, match="export the checkpoint again"):
        load_bundle(edit(folder, lambda values: values.update(format=0)))


def sub(key, **values):
    return lambda manifest: manifest[key].update(values)


def sensor(**values):
    return lambda manifest: manifest["sensors"][0].update(values)


def image(**values):
    return lambda manifest: manifest["sensors"][0]["range_image"].update(values)


def file(name="image_net.onnx", **values):
    return lambda manifest: manifest["files"][name].update(values)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(colour="red"), "unknown entry colour"),
        (lambda m: m.pop("sensors"), "has no sensors"),
        (lambda m: m.update(sensors=None), "sensors"),
        (lambda m: m.update(sensors=[]), "lists no sensor"),
        (lambda m: m.update(files={}), "no image network"),
        (lambda m: m.update(classes=["static", "moving"]), "classes are"),
        (lambda m: m.update(point_head=None), "must both be there, or neither"),
        (lambda m: m["files"].pop("point_head.npz"), "must both be there, or neither|not in the manifest"),
        (lambda m: m.update(features=8), "takes 4 features, the image network gives 8"),
        (lambda m: m.update(postprocess="guess"), "postprocess 'guess'"),
        (lambda m: m["files"].update({"../x": m["files"]["image_net.onnx"]}), "not one that a bundle holds"),
        (image(height=63), "multiple of 16"),
        (image(height="64"), "height: must be a whole number"),
        (image(beams=64), "unknown entry beams"),
        (image(height=64.0), "height: must be a whole number"),
        (image(height=True), "height: must be a whole number"),
        (image(fov_up=float("nan")), "holds NaN"),
        (image(fov_up=10**400), "finite"),
        (image(mean=[1, 2, "3", 4, 5]), r"mean\[2\]: must be a number"),
        (sensor(reach=-1), "reach"),
        (sensor(name=5), "name: must be a text"),
        (sub("tuned", candidate=1), "candidate"),
        (sub("tuned", halo="wide"), "halo"),
        (sub("residual", lags=[3, 2]), "lags"),
        (sub("residual", lags=9), "residual"),
        (sub("point_head", reduce="max"), "reduce"),
        (sub("point_head", down=8), "point_head"),
        (sensor(decision={"threshold": 2}), "threshold"),
        (sensor(decision={"belief_threshold": 1}), "threshold"),
        (sensor(decision={"threshold": "high"}), "threshold"),
        (file(precision="int8"), "precision 'int8', not float32 or float16"),
        (file(bytes=None), "image_net.onnx"),
        (file(colour="red"), "unknown entry colour"),
    ],
)
def test_every_contradiction_of_a_manifest_is_an_error(folder, change, message):
    with pytest.raises(BundleError, match=message):
        load_bundle(edit(folder, change))


def test_a_manifest_of_format_1_loads():
    """The shipped one before format 2: its reach is unknown, what was in code are the defaults."""
    values = json.loads((DATA / "manifest_format_1.json").read_text())
    old = parse_manifest(values, "old")
    assert (old.format, old.network, old.tuned) == (2, "rt", Tuned())
    assert old.sensor == SensorEntry("hdl64e", RangeImage(), UNKNOWN_REACH, Decision(0.635, 0.58))
    assert old.residual == Residual(kind="signed")
    assert old.point_head == load_bundle().manifest.point_head
    assert {name: entry.sha256 for name, entry in old.files.items()} == {
        name: entry["sha256"] for name, entry in values["files"].items()
    }


def test_broken_weights_of_the_point_head_are_an_error(folder):
    path = folder / "point_head.npz"
    path.write_bytes(b"PK\x03\x04 not an archive")
    entry = {"sha256": module.sha256_of(path), "bytes": path.stat().st_size}
    bundle = load_bundle(edit(folder, file("point_head.npz", **entry)))
    with pytest.raises(BundleError, match=r"point_head\.npz: holds no weights"):
        bundle.point_head()


def test_pickles_in_the_weights_are_refused(folder):
    path = folder / "point_head.npz"
    np.savez(path, weights=np.array([object()], dtype=object))
    entry = {"sha256": module.sha256_of(path), "bytes": path.stat().st_size}
    bundle = load_bundle(edit(folder, file("point_head.npz", **entry)))
    with pytest.raises(BundleError, match="holds no weights"):
        bundle.point_head()


def test_without_a_default_bundle_the_error_says_how_to_pass_one(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "__file__", str(tmp_path / "runtime" / "bundle" / "loading.py"))
    with pytest.raises(BundleError, match=r"name one .`bundle='path/to/bundle'`."):
        default_bundle_path()
    with pytest.raises(BundleError, match="no default bundle"):
        load_bundle()


@pytest.mark.parametrize("place", ["runtime/default_bundle", f"models/{module.DEFAULT_BUNDLE}"])
def test_the_default_bundle_is_found(monkeypatch, tmp_path, place):
    monkeypatch.setattr(module, "__file__", str(tmp_path / "runtime" / "bundle" / "loading.py"))
    found = shutil.copytree(BUNDLE, tmp_path / place)
    assert default_bundle_path().samefile(found)


def test_a_default_bundle_without_training_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "__file__", str(tmp_path / "runtime" / "bundle" / "loading.py"))
    shutil.copytree(BUNDLE, tmp_path / "runtime" / "default_bundle")
    for load in (load_bundle, MosRunner):
        with pytest.raises(BundleError, match="not trained"):
            load()

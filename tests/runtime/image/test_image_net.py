"""The image network on ONNX Runtime: what it returns, and what it refuses."""

import dataclasses
import shutil

import numpy as np
import pytest

from runtime.bundle.loading import load_bundle
from runtime.bundle.residual import Residual
from runtime.bundle.view import View
from runtime.compute.sessions import CPU
from runtime.errors import BundleError, InferenceError
from runtime.image.image_net import ImageNet
from runtime.sensors.range_image import RangeImage
from tests.support.paths import BUNDLE


def image(seed=0):
    return np.random.default_rng(seed).normal(size=(13, 64, 256)).astype(np.float32)


@pytest.fixture(scope="module")
def net():
    return ImageNet.of(load_bundle(BUNDLE), threads=2)


def test_probabilities_and_features(net):
    probabilities, features = net.run(image())
    assert probabilities.shape == (3, 64, 256)
    assert features.shape == (4, 64, 256)
    assert probabilities.dtype == features.dtype == np.float32
    np.testing.assert_allclose(probabilities.sum(0), 1, atol=1e-5)
    assert net.providers == [CPU]
    assert net.shape == (1, 13, 64, 256)


def test_results_stay_and_inputs_are_not_written(net):
    given = image()
    given.setflags(write=False)
    first = net.run(given)
    copies = [array.copy() for array in first]
    net.run(image(1))
    for array, copy in zip(first, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_views_and_one_thread_give_the_same(net):
    want = net.run(image())
    strided = np.asfortranarray(image())
    for other, given in ((net, strided), (ImageNet.of(load_bundle(BUNDLE), threads=1), image())):
        for a, b in zip(want, other.run(given), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_never_a_result(net, value):
    given = image()
    given[0, 10, 10] = value
    with pytest.raises(InferenceError, match="not finite"):
        net.run(given)


def test_overflow_of_the_features_is_noticed(net):
    with pytest.raises(InferenceError, match="not finite"):
        net.run(np.full((13, 64, 256), 3e38, np.float32))


@pytest.mark.parametrize(
    "given", [np.zeros((13, 64, 128), np.float32), np.zeros((5, 64, 256), np.float32), image().astype(float)]
)
def test_an_image_that_does_not_fit_is_an_error(net, given):
    with pytest.raises(InferenceError, match=r"takes \(13, 64, 256\) float32"):
        net.run(given)


@pytest.mark.parametrize(("height", "width"), [(16, 1792), (64, 256), (128, 96)])
def test_images_of_every_sensor_are_taken(height, width):
    view = View(RangeImage(height, width), Residual())
    net = ImageNet.of(load_bundle(BUNDLE), view=view, threads=1)
    seen = net.run(np.zeros((13, height, width), np.float32))
    assert seen.probabilities.shape == (3, height, width)
    with pytest.raises(InferenceError, match=rf"takes \(13, {height}, {width}\)"):
        net.run(np.zeros((13, height, 2 * width), np.float32))


def test_a_network_that_is_not_what_the_manifest_says_is_an_error(tmp_path):
    bundle = load_bundle(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    for manifest, message in (
        (dataclasses.replace(bundle.manifest, residual=Residual((1, 2))), r"\(1, 13, 64, 256\), the manifest says"),
        (dataclasses.replace(bundle.manifest, features=8), "gives 4 features, the manifest says 8"),
    ):
        with pytest.raises(BundleError, match=message):
            ImageNet.of(dataclasses.replace(bundle, manifest=manifest), threads=1)

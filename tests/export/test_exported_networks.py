"""The published outputs through exported files: ONNX Runtime for the image networks, Numba for the point heads."""

import shutil

import numpy as np
import pytest
import torch

from export.bundle.head_weights import write_point_head
from export.bundle.write import rounded_to_half
from export.checkpoint.published import understand
from export.graph.image_graph import image_bytes
from mos_model.networks.registry import named_config
from runtime.bundle.head_shape import FULL, LITE
from runtime.bundle.loading import Bundle, load_bundle
from runtime.bundle.manifest import IMAGE_NET
from runtime.bundle.residual import Residual
from runtime.bundle.view import View
from runtime.compute.sessions import open_session
from runtime.compute.workers import Workers
from runtime.errors import BundleError
from runtime.head.numba_engine import PointHeadEngine
from runtime.image.image_net import ImageNet
from runtime.sensors.range_image import RangeImage
from tests.support.paths import BUNDLE
from tests.support.published import reference_head, reference_output, reference_state

TOLERANCE = 1e-5  # of a probability; the gate of the export is 1e-4
SHAPE = (1, 13, 64, 256)


def exported(network, image):
    session = open_session(image_bytes(network, SHAPE), threads=2)
    return session.run(["probabilities", "features"], {"image": np.asarray(image)})


def published_network(name, seed, tmp_path):
    return understand({"state_dict": reference_state(name, seed)}, tmp_path / "checkpoint").image_net


@pytest.mark.parametrize("name", ["image_net", "lmnet"])
def test_published_image_networks(name, tmp_path):
    image = reference_output("image_net_64x256")["input"]
    want = reference_output(f"{name}_64x256")
    probabilities, features = exported(published_network(name, 2026, tmp_path), image)
    np.testing.assert_allclose(probabilities, want["probabilities"], atol=TOLERANCE, rtol=0)
    if "features" in want:
        scale = want["features"].abs().max()
        np.testing.assert_allclose(features, want["features"], atol=TOLERANCE * scale, rtol=0)


@pytest.mark.parametrize("half", [False, True])
def test_another_seed_and_rounded_weights(half, tmp_path):
    image = reference_output("image_net_64x256")["input"].flip(3)
    network = published_network("image_net", 7, tmp_path)
    if half:
        rounded_to_half(network, "test")
    with torch.inference_mode():
        want = network(image).logits.softmax(1)
    np.testing.assert_allclose(exported(network, image)[0], want, atol=TOLERANCE, rtol=0)


@pytest.mark.parametrize(("kind", "config"), [("full", FULL), ("lite", LITE)])
def test_published_point_heads(kind, config, tmp_path):
    reference = reference_output(f"point_head_{kind}")
    head = reference_head(kind)
    write_point_head(tmp_path / "point_head.npz", head, config, half=False)
    got = refined(tmp_path, config, reference["xyz"].numpy(), reference["point_features"].numpy())
    np.testing.assert_allclose(got, reference["probabilities"], atol=TOLERANCE, rtol=0)


@pytest.mark.parametrize("half", [False, True])
def test_a_point_head_of_another_seed_and_rounded_weights(half, tmp_path):
    reference = reference_output("point_head_lite")
    xyz, features = reference["xyz"][:2000] + 1, reference["point_features"][:2000]
    head = reference_head("lite", 7)
    if half:
        rounded_to_half(head, "test")
    write_point_head(tmp_path / "point_head.npz", head, LITE, half)
    with torch.inference_mode():
        want = head(head.grid(xyz), features).softmax(1)
    got = refined(tmp_path, LITE, xyz.numpy(), features.numpy())
    np.testing.assert_allclose(got, want, atol=TOLERANCE, rtol=0)


def refined(folder, config, xyz, features):
    """Probabilities by the runtime's engine, from the written file."""
    engine = PointHeadEngine(Bundle(folder, None).point_head(), config, Workers(2))
    return engine.refine(xyz, np.ones(len(xyz), np.bool_), features)


def test_a_file_for_images_of_one_size_takes_no_others(tmp_path):
    """As bundles were written once."""
    bundle = load_bundle(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    network, shape = named_config("v2-lite", 4).build_image_network().eval(), (1, 13, 64, 256)
    (bundle.path / IMAGE_NET).write_bytes(image_bytes(network, shape))
    assert ImageNet.of(bundle, threads=1).shape == shape
    with pytest.raises(BundleError, match=r"no image of 16 x 1792: its network is for images of 64 x 256"):
        ImageNet.of(bundle, view=View(RangeImage(16, 1792), Residual()), threads=1)


def test_the_same_network_gives_the_same_bytes():
    torch.manual_seed(0)
    network = named_config("v1", 4).build_image_network().eval()
    assert image_bytes(network, (1, 13, 32, 64)) == image_bytes(network, (1, 13, 32, 64))

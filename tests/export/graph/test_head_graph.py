"""The point head as an ONNX graph: the numbers of the published network, of PyTorch and of the Numba engine."""

from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch

from export.bundle.head_weights import fold, head_arrays
from export.bundle.write import rounded_to_half
from export.graph.head_graph import head_bytes
from mos_model.networks.point_head import PointHead
from runtime.bundle.head_shape import FULL, LITE, SMALL, PointHeadConfig
from runtime.compute.workers import Workers
from runtime.errors import BundleError, InferenceError
from runtime.head.numba_engine import FeatureMap, PointHeadEngine
from runtime.head.onnx_engine import OnnxHead
from tests.support import reference_voxels as reference
from tests.support.published import reference_head, reference_output

TOLERANCE = 1e-5  # of a probability; the gate of the export is 1e-4
ODD = PointHeadConfig(in_channels=5, down=(6, 20), up=(17, 9), fuse_after_up=None)
DEEP = PointHeadConfig(in_channels=8, down=(8, 12, 16), up=(12, 16, 8), fuse_after_up=1, voxel_size=0.1)


def onnx_head(tmp_path, weights, config, threads=2):
    path = tmp_path / "point_head.onnx"
    path.write_bytes(head_bytes(weights, config))
    return OnnxHead(path, config, Workers(threads))


@pytest.fixture(scope="module")
def engines(tmp_path_factory):
    """(ONNX, Numba) heads of a configuration with random weights."""
    made = {}

    def make(config):
        if config not in made:
            weights = fold(reference.random_weights(config, 3), config)
            head = onnx_head(tmp_path_factory.mktemp("head"), weights, config)
            made[config] = head, PointHeadEngine(weights, config, Workers(2))
        return made[config]

    return make


def scan(config, seed=0, count=700, extent=3.0):
    """(xyz, valid, features); one point in twenty is not valid."""
    random = np.random.default_rng(seed)
    valid = random.random(count) > 0.05
    return reference.surfaces(seed, count, extent), valid, random.normal(size=(count, config.in_channels))


@pytest.mark.parametrize(("name", "config"), [("full", FULL), ("lite", LITE)])
def test_published_networks(name, config, tmp_path):
    want = reference_output(f"point_head_{name}")
    xyz, features = want["xyz"].numpy(), want["point_features"].numpy()
    head = onnx_head(tmp_path, head_arrays(reference_head(name), config, half=False), config)
    valid = np.ones(len(xyz), bool)
    found = head.refine(xyz, valid, features)
    np.testing.assert_allclose(found, want["probabilities"], atol=TOLERANCE, rtol=0)
    candidates = np.abs(xyz - xyz[0]).max(axis=1) < 0.5
    near = head.refine(xyz, valid, features, candidates, "exact")
    np.testing.assert_allclose(near[candidates], found[candidates], atol=TOLERANCE, rtol=0)
    assert np.isnan(near[~candidates]).all()


def test_half_precision_is_that_of_the_checkpoint(tmp_path):
    """Kernels stored in half precision give what PyTorch computes with the rounded kernels."""
    torch.manual_seed(0)
    head = PointHead(SMALL).eval()
    for module in head.modules():
        if isinstance(module, torch.nn.BatchNorm1d):
            module.running_var.uniform_(0.1, 0.3)
    rounded_to_half(head, "test")
    arrays = head_arrays(head, SMALL, half=True)
    xyz, _, features = (torch.from_numpy(array) for array in scan(SMALL))
    with torch.inference_mode():
        want = head(head.grid(xyz), features.float()).softmax(1)
    found = onnx_head(tmp_path, arrays, SMALL).refine(xyz.numpy(), np.ones(len(xyz), bool), features.numpy())
    np.testing.assert_allclose(found, want, atol=TOLERANCE, rtol=0)
    assert len(head_bytes(arrays, SMALL)) < 0.8 * len(head_bytes(head_arrays(head, SMALL, half=False), SMALL))


@pytest.mark.parametrize(
    "config", [SMALL, ODD, DEEP, replace(DEEP, fuse_after_up=2), replace(ODD, reduce="mean", down=(16,), up=(9,))]
)
def test_any_configuration(config, engines):
    """Other depths, widths, voxel sizes and reductions; whole scans and surroundings of candidates."""
    head, engine = engines(config)
    xyz, valid, features = scan(config, 5, 3000, 20.0)
    candidates = np.abs(xyz - xyz[7]).max(axis=1) < 1
    for asked in ((), (candidates,), (candidates, 0.0), (candidates, "exact"), (~valid,)):
        found, want = (each.refine(xyz, valid, features, *asked) for each in (head, engine))
        np.testing.assert_allclose(found, want, atol=TOLERANCE, rtol=0)
        assert head.voxels == engine.voxels
    assert set(head.timing) == set(engine.timing)


@pytest.mark.parametrize("config", [SMALL, DEEP])
@pytest.mark.parametrize("count", [0, 1, 2, 9])
def test_small_scans(config, count, engines):
    """Nothing, one voxel, all points in one voxel, duplicates; right after a larger scan."""
    head, engine = engines(config)
    head.refine(*scan(config))
    random, valid = np.random.default_rng(count), np.ones(count, bool)
    features = random.normal(size=(count, config.in_channels)).astype(np.float32)
    for spread in (0.0, 0.01, 3.0):
        xyz = np.full((count, 3), 2.01, np.float32) + random.uniform(0, spread, (count, 3)).astype(np.float32)
        found = head.refine(xyz, valid, features)
        assert found.shape == (count, 3)
        np.testing.assert_allclose(found, engine.refine(xyz, valid, features), atol=TOLERANCE, rtol=0)
    assert np.isnan(head.refine(xyz, ~valid, features)).all()


def test_features_of_an_image(engines):
    head, engine = engines(ODD)
    xyz, valid, _ = scan(ODD, 2)
    random = np.random.default_rng(2)
    pixel = random.integers(-9, 16 * 32, len(xyz)).astype(np.int32)
    image = FeatureMap(random.normal(size=(5, 16, 32)).astype(np.float32), pixel, 32)
    np.testing.assert_allclose(head.refine(xyz, valid, image), engine.refine(xyz, valid, image), atol=TOLERANCE)


def test_features_that_are_not_finite(engines):
    head, _ = engines(ODD)
    xyz, valid, features = scan(ODD, 13)
    features[np.flatnonzero(valid)[0]] = np.nan
    with pytest.raises(InferenceError, match="not finite"):
        head.refine(xyz, valid, features)


def test_a_graph_of_another_head_is_an_error(tmp_path):
    weights = fold(reference.random_weights(ODD), ODD)
    path = tmp_path / "point_head.onnx"
    path.write_bytes(head_bytes(weights, ODD))
    for other in (DEEP, replace(ODD, in_channels=6)):
        with pytest.raises(BundleError, match="is not the graph of this point head"):
            OnnxHead(path, other, Workers(1))


def test_the_graph_is_small_standard_and_always_the_same():
    weights = fold(reference.random_weights(SMALL), SMALL)
    model = onnx.load_from_string(head_bytes(weights, SMALL))
    assert {node.op_type for node in model.graph.node} <= {
        "Add", "Concat", "Gather", "Gemm", "MatMul", "Mul", "Relu", "Reshape", "Slice", "Softmax"
    }  # fmt: skip
    assert [opset.version for opset in model.opset_import] == [17]
    assert len(model.graph.node) < 400
    assert head_bytes(weights, SMALL) == head_bytes(weights, SMALL)

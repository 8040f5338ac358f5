"""Features on their way, against dictionaries of voxels."""

import numpy as np
import pytest

from runtime.compute.arena import Arena
from runtime.compute.workers import Workers
from runtime.head.sparse.kernel_map import build_scales, neighbours
from runtime.head.transfer import FeatureMap, classify, exchange, features_to_voxels, to_points
from runtime.head.voxels import voxelise
from tests.support import reference_voxels as reference


@pytest.mark.parametrize("level", [0, 1, 2, 4])
@pytest.mark.parametrize("cloud", ["surfaces", "dense", "one"])
def test_exchange(level, cloud):
    random = np.random.default_rng(level)
    xyz = {
        "surfaces": reference.surfaces(level, 800, 3.0),
        "dense": random.uniform(0.1, 0.5, (900, 3)).astype(np.float32),
        "one": np.ones((2, 3), np.float32),
    }[cloud]
    workers, stride = Workers(2), 2**level
    voxels = voxelise(xyz, 0.05, workers)
    scales = build_scales(voxels.keys, 4, Arena())
    table = neighbours(scales, level, Arena(), workers)[level]
    members = np.arange(len(voxels.keys) + 1, dtype=np.int32)
    for scale in scales[1 : level + 1]:
        members = members[scale.starts]
    fine = [tuple(c) for c in voxels.coords.tolist()]
    coarse = [reference.parent(fine[i], stride) for i in members[:-1]]
    x = random.normal(size=(len(coarse), 19)).astype(np.float32)
    z = random.normal(size=(len(fine), 19)).astype(np.float32)
    old = reference.voxels_to_points(dict(zip(coarse, x, strict=True)), fine, stride)
    expected = {v: old[v] + row for v, row in zip(fine, z, strict=True)}
    out = np.full_like(x, np.nan)
    exchange(x, table, members, voxels.keys, level, z, out, workers)
    np.testing.assert_allclose(z, [expected[v] for v in fine], atol=1e-5)
    means = reference.points_to_voxels(expected, stride)
    np.testing.assert_allclose(out, [means[v] for v in coarse], atol=1e-5)


@pytest.mark.parametrize("mean", [False, True])
@pytest.mark.parametrize("channels", [3, 16, 37])
@pytest.mark.parametrize("order", ["channels first", "channels last"])
@pytest.mark.parametrize("share", [1, 2])
def test_features_to_voxels(mean, channels, order, share):
    random = np.random.default_rng(channels)
    xyz = random.uniform(0.1, 1.0, (6000, 3)).astype(np.float32)
    voxels = voxelise(xyz, 0.05, Workers(1))
    image = random.normal(size=(channels, 10, 50)).astype(np.float32)
    if order == "channels last":
        image = np.ascontiguousarray(image.transpose(1, 2, 0)).transpose(2, 0, 1)
    pixel = random.integers(-1, 10 * 50 * share, len(xyz)).astype(np.int32)  # -1: none, zeros
    out = np.full((len(voxels.keys), 48), np.nan, np.float32)
    features_to_voxels(FeatureMap(image, pixel, 50 * share), voxels, mean, out, Workers(2))
    of_points = np.where(pixel[:, None] >= 0, image[:, pixel // (50 * share), pixel // share % 50].T, 0)
    for v, found in enumerate(out):
        members = np.flatnonzero(voxels.inverse == v)
        expected = of_points[members].mean(axis=0) if mean else of_points[members[0]]
        np.testing.assert_allclose(found[:channels], expected, atol=1e-6)
    assert (out[:, channels:] == 0).all()


def test_classify():
    random = np.random.default_rng(0)
    points, voxels = random.normal(size=(2, 5000, 16)).astype(np.float32) * 30  # far beyond what exp takes
    weight, bias = random.normal(size=(3, 11)).astype(np.float32), random.normal(size=3).astype(np.float32)
    found = classify(points, voxels, weight, bias, np.empty((5000, 3), np.float32), Workers(2))
    logits = (points + voxels)[:, :11].astype(np.float64) @ weight.T + bias
    expected = np.exp(logits - logits.max(axis=1, keepdims=True))
    np.testing.assert_allclose(found, expected / expected.sum(axis=1, keepdims=True), atol=2e-5)


def test_to_points():
    probabilities = np.arange(6, dtype=np.float32).reshape(2, 3)
    out = np.full((5, 3), np.nan, np.float32)
    order, starts = np.array([2, 0, 3, 4], np.int32), np.array([0, 1, 4], np.int32)
    to_points(probabilities, order, starts, np.array([True, True, True, False, True]), out)
    np.testing.assert_equal(out, [[3, 4, 5], [np.nan] * 3, [0, 1, 2], [np.nan] * 3, [3, 4, 5]])

"""Sparse convolution and dense layers against loops over a dictionary."""

import numpy as np
import pytest

from runtime.compute.arena import Arena
from runtime.compute.workers import Workers
from runtime.errors import ScanError
from runtime.head.sparse.convolution import LANES, Layers, convolve, dense, pack, padded
from runtime.head.sparse.kernel_map import build_scales, neighbours, table_map, up_map
from runtime.head.voxels import voxelise
from tests.support import reference_voxels as reference


class Scene:
    """Voxels of two strides with their maps, and features as array and dictionary."""

    def __init__(self, seed=0, count=500, threads=2):
        self.workers = Workers(threads)
        voxels = voxelise(reference.surfaces(seed, count, 3.0), 0.05, self.workers)
        scales = build_scales(voxels.keys, 1, Arena())
        self.fine = [tuple(c) for c in voxels.coords.tolist()]
        self.coarse = [tuple(c // 2 * 2 for c in self.fine[i]) for i in scales[1].starts[:-1]]
        n, m = len(self.fine), len(self.coarse)
        table = neighbours(scales, 0, Arena(), self.workers)[0]
        self.same = table_map(table, n, Arena(), self.workers, "same")
        self.down = table_map(scales[1].child, n, Arena(), self.workers, "down")
        self.up = up_map(scales[0], m, Arena(), self.workers, "up")
        self.random = np.random.default_rng(seed)

    def features(self, rows, channels):
        """(filled-up array, dictionary)."""
        values = self.random.normal(size=(len(rows), channels)).astype(np.float32)
        full = np.zeros((len(rows), padded(channels)), np.float32)
        full[:, :channels] = values
        return full, dict(zip(rows, values.astype(np.float64), strict=True))

    def weights(self, *shape):
        return self.random.normal(0, 0.3, shape).astype(np.float32)


def empty(kernel_map, channels):
    return np.full((kernel_map.count_out, padded(channels)), np.nan, np.float32)


def rows_of(found, voxels):
    return np.array([found[voxel] for voxel in voxels])


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (3, 16), (16, 3), (17, 40), (32, 32), (96, 64), (5, 130)])
@pytest.mark.parametrize("threads", [1, 2])
def test_convolution(inputs, outputs, threads):
    scene = Scene(inputs, threads=threads)
    x, named = scene.features(scene.fine, inputs)
    kernel, bias = scene.weights(27, inputs, outputs), scene.weights(outputs)
    expected = rows_of(reference.conv3(named, kernel, 1), scene.fine) + bias
    weights = pack(kernel, bias)
    found = convolve(x, scene.same, weights, empty(scene.same, outputs), scene.workers, relu=False)
    np.testing.assert_allclose(found[:, :outputs], expected, atol=2e-4)
    assert (found[:, outputs:] == 0).all()
    found = convolve(x, scene.same, weights, found, scene.workers)
    np.testing.assert_allclose(found[:, :outputs], np.maximum(expected, 0), atol=2e-4)


@pytest.mark.parametrize(("inputs", "outputs"), [(3, 18), (32, 48)])
def test_down_and_up(inputs, outputs):
    scene = Scene(4)
    kernel, bias = scene.weights(8, inputs, outputs), np.zeros(outputs)
    x, named = scene.features(scene.fine, inputs)
    found = convolve(x, scene.down, pack(kernel, bias), empty(scene.down, outputs), scene.workers, relu=False)
    expected = rows_of(reference.down(named, kernel, 1), scene.coarse)
    np.testing.assert_allclose(found[:, :outputs], expected, atol=2e-4)
    x, named = scene.features(scene.coarse, inputs)
    found = convolve(x, scene.up, pack(kernel), empty(scene.up, outputs), scene.workers, relu=False)
    expected = rows_of(reference.up(named, kernel, 1, scene.fine), scene.fine)
    np.testing.assert_allclose(found[:, :outputs], expected, atol=2e-4)


def test_residual_and_shortcut():
    scene = Scene(5)
    x, named = scene.features(scene.fine, 20)
    before, _ = scene.features(scene.fine, 40)
    side, _ = scene.features(scene.fine, 7)
    kernel, bias = scene.weights(27, 20, 40), scene.weights(40)
    across, across_bias = scene.weights(7, 40), scene.weights(40)
    base = rows_of(reference.conv3(named, kernel, 1), scene.fine) + bias
    weights = pack(kernel, bias)
    found = convolve(x, scene.same, weights, empty(scene.same, 40), scene.workers, residual=before)
    np.testing.assert_allclose(found[:, :40], np.maximum(base + before[:, :40], 0), atol=2e-4)
    expected = np.maximum(base + side[:, :7] @ across + across_bias, 0)
    shortcut = (side, pack(across, across_bias))
    found = convolve(x, scene.same, weights, empty(scene.same, 40), scene.workers, shortcut=shortcut)
    np.testing.assert_allclose(found[:, :40], expected, atol=2e-4)
    assert np.array_equal(convolve(x, scene.same, weights, before, scene.workers, residual=before), before)


def test_columns_of_a_wider_array():
    """A concatenation: inputs with two parts, output into the right-hand columns, the rest untouched."""
    scene = Scene(6)
    left, left_named = scene.features(scene.fine, 5)
    right, right_named = scene.features(scene.fine, 18)
    named = {v: np.concatenate((left_named[v], right_named[v])) for v in scene.fine}
    kernel = scene.weights(27, 23, 10)
    out = np.full((len(scene.fine), 3 * LANES), 7, np.float32)
    weights = pack(kernel, parts=(5, 18))
    joined = np.ascontiguousarray(np.hstack((left, right)))
    convolve(joined, scene.same, weights, out[:, LANES : 2 * LANES], scene.workers, relu=False)
    expected = rows_of(reference.conv3(named, kernel, 1), scene.fine)
    np.testing.assert_allclose(out[:, LANES : LANES + 10], expected, atol=2e-4)
    assert (out[:, :LANES] == 7).all()
    assert (out[:, 2 * LANES :] == 7).all()
    again = convolve(joined[:, LANES:], scene.same, pack(kernel[:, 5:]), empty(scene.same, 10), scene.workers)
    expected = rows_of(reference.conv3(right_named, kernel[:, 5:], 1), scene.fine)
    np.testing.assert_allclose(again[:, :10], np.maximum(expected, 0), atol=2e-4)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 64, 700, 3001])
def test_dense(count):
    random = np.random.default_rng(count)
    x = random.normal(size=(count, 32)).astype(np.float32)
    kernel, bias = random.normal(size=(32, 21)).astype(np.float32), random.normal(size=21).astype(np.float32)
    out = np.empty((count, 32), np.float32)
    found = dense(x, pack(kernel, bias), out, Workers(2))
    np.testing.assert_allclose(found[:, :21], np.maximum(x @ kernel + bias, 0), atol=1e-4)


def test_not_a_number_stays_where_it_is():
    """NaN is not hidden by ReLU, and pairs that only fill up a run carry nothing over."""
    scene = Scene(7)
    x, _ = scene.features(scene.fine, 16)
    x[0] = np.nan
    found = convolve(x, scene.same, pack(scene.weights(27, 16, 16)), empty(scene.same, 16), scene.workers)
    near = np.abs(np.array(scene.fine) - scene.fine[0]).max(axis=1) <= 1
    assert np.isnan(found[near]).all()
    assert np.isfinite(found[~near]).all()


def test_same_bits_with_any_number_of_threads():
    outs = []
    for threads in (1, 3, 16):  # 16: far more than processors, so that each waits for others
        scene = Scene(8, 3000, threads)
        x, _ = scene.features(scene.fine, 32)
        weights = pack(scene.weights(27, 32, 32))
        outs.append(convolve(x, scene.same, weights, empty(scene.same, 32), scene.workers))
    assert all(np.array_equal(outs[0], out) for out in outs)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_layers_in_one_run(threads):
    """Each layer reads what the one before wrote, also where the first has one tile and the second has many."""
    scene = Scene(10, 3000, threads)
    x, _ = scene.features(scene.coarse, 48)
    first, second, third = (pack(scene.weights(*shape)) for shape in ((8, 48, 80), (27, 80, 32), (32, 32)))
    outs = []
    for together in (False, True):
        up, same, last = (np.empty((len(scene.fine), columns), np.float32) for columns in (80, 32, 32))
        if together:
            layers = Layers(scene.workers)
            layers.convolve(x, scene.up, first, up)
            layers.convolve(up, scene.same, second, same)
            layers.dense(same, third, last)
            last[:] = np.nan
            layers.run()
            last_run = last.copy()
            layers.run()  # nothing is left to do
            assert np.array_equal(last, last_run)
        else:
            convolve(x, scene.up, first, up, scene.workers)
            convolve(up, scene.same, second, same, scene.workers)
            dense(same, third, last, scene.workers)
        outs.append(last)
    assert np.array_equal(*outs)


def test_arrays_that_do_not_fit():
    scene = Scene(9)
    x, _ = scene.features(scene.fine, 16)
    weights, out = pack(scene.weights(27, 16, 16)), empty(scene.same, 16)
    run = {"kernel_map": scene.same, "weights": weights, "workers": scene.workers}
    for wrong in (x[1:], x[:, :8], x.astype(np.float64), np.asfortranarray(x)):
        with pytest.raises(ScanError, match="features"):
            convolve(wrong, out=out, **run)
    with pytest.raises(ScanError, match="out"):
        convolve(x, out=out[1:], **run)
    with pytest.raises(ScanError, match="columns"):
        convolve(x, out=empty(scene.same, 32), **run)
    with pytest.raises(ScanError, match="residual"):
        convolve(x, out=out, residual=out[1:], **run)
    with pytest.raises(ScanError, match="shortcut"):
        convolve(x, out=out, shortcut=(out[:, :8], weights), **run)

"""Who meets whom among the cells of a cylinder, against loops over a dictionary; in PyTorch too."""

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from mos_model.networks.cylinder_grid import CylinderGrid
from runtime.compute.arena import Arena
from runtime.compute.workers import Workers
from runtime.head.cylinder.cells import KERNELS, STRIDES, coarser, kernel_map, meeting, occupied
from runtime.head.sparse.convolution import convolve, pack, padded
from tests.support import reference_cylinder as reference

SIZE = (13, 10, 7)  # odd and even


def numbers(seed, count):
    rng = np.random.default_rng(seed)
    return rng.integers(0, np.prod(SIZE), count).astype(np.int32)


def places(cells, size):
    return [tuple(int(n) for n in place) for place in np.stack(np.unravel_index(cells, size), 1)]


@pytest.mark.parametrize("count", [1, 40, 400])
def test_scales_and_tables(count):
    given, workers = numbers(count, count), Workers(2)
    found = [occupied(np.append(given, np.int32(-1)), SIZE, Arena())]
    for level in range(1, 5):
        found.append(coarser(found[-1], level, Arena()))
    want = reference.scales(set(places(given, SIZE)), SIZE)
    grid = CylinderGrid.of(torch.from_numpy(given).long(), torch.zeros(count, dtype=torch.int64), SIZE)
    for level, (scale, (cells, size)) in enumerate(zip(found, want, strict=True)):
        assert (places(scale.cells, size), scale.size) == (cells, size)
        assert grid.levels[level].keys.tolist() == scale.cells.tolist()
        table = meeting(scale, scale, (1, 1, 1), False, Arena(), workers, "t")[:-1]
        np.testing.assert_array_equal(table, reference.table(cells, cells, (1, 1, 1), False))
        assert_same(grid.levels[level].around, table, len(cells))
        if level:
            finer, stride = want[level - 1][0], STRIDES[level - 1]
            down = meeting(scale, found[level - 1], stride, False, Arena(), workers, "t")[:-1]
            up = meeting(found[level - 1], scale, stride, True, Arena(), workers, "t")[:-1]
            np.testing.assert_array_equal(down, reference.table(cells, finer, stride, False))
            np.testing.assert_array_equal(up, reference.table(finer, cells, stride, True))
            assert_same(grid.levels[level].down, down, len(finer))
            assert_same(grid.levels[level].up, up, len(cells))


def assert_same(pairs, table, none):
    """A kernel map of PyTorch's and a table name the same pairs."""
    assert pairs.outputs == len(table)
    for k, (source, target) in enumerate(zip(pairs.source, pairs.target, strict=True)):
        column = np.full(len(table), none)
        column[target.numpy()] = source.numpy()
        np.testing.assert_array_equal(column, table[:, k])


@pytest.mark.parametrize("kernel", KERNELS)
def test_flat_kernels_are_those_of_a_dense_convolution(kernel):
    """With LeakyReLU, scale, shift and residual behind it, in the same pass."""
    given, workers, rng = numbers(3, 300), Workers(2), np.random.default_rng(0)
    scale = occupied(given, SIZE, Arena())
    cells = scale.cells
    x, residual = (rng.normal(size=(len(cells), c)).astype(np.float32) for c in (5, 20))
    weight = rng.normal(0, 0.3, (len(KERNELS[kernel]), 5, 20)).astype(np.float32)
    after = rng.normal(0, 1, (2, 20)).astype(np.float32)
    dense = torch.zeros(1, 5, np.prod(SIZE))
    dense[0][:, cells] = torch.from_numpy(x.T.copy())
    sides = [int(n) for n in kernel.split("x")]
    kernel_5d = torch.from_numpy(weight).reshape(*sides, 5, 20).permute(4, 3, 0, 1, 2)
    out = F.conv3d(dense.reshape(1, 5, *SIZE), kernel_5d, padding=[n // 2 for n in sides])
    of_cells = F.leaky_relu(out.reshape(20, -1)[:, cells].T, 0.01).numpy()
    table = meeting(scale, scale, (1, 1, 1), False, Arena(), workers, "t")
    pairs = kernel_map(table, kernel, len(cells), Arena(), workers, "k")
    full, beside = (np.zeros((len(cells), padded(c)), np.float32) for c in (5, 20))
    full[:, :5], beside[:, :20] = x, residual
    found = np.empty((len(cells), padded(20)), np.float32)
    convolve(full, pairs, pack(weight, after=after), found, workers, residual=beside, relu=False)
    np.testing.assert_allclose(found[:, :20], of_cells * after[0] + after[1] + residual, atol=1e-4)
    assert not found[:, 20:].any()

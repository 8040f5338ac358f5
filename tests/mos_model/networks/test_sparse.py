import numpy as np
import pytest
import torch

from mos_model.networks.sparse import SparseConv, points_to_voxels, sparse_convolution, voxels_to_points
from mos_model.networks.voxels import KernelMap, VoxelGrid
from tests.mos_model.networks.test_voxels import cloud, pairs
from tests.support import reference_network as reference


def random(*shape: int) -> torch.Tensor:
    return torch.randn(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(sum(shape)))


def maps(grid: VoxelGrid) -> list[tuple[KernelMap, int]]:
    """Kernel map and number of input rows of every kind of convolution at the first two levels."""
    fine, coarse = len(grid.levels[0].keys), len(grid.levels[1].keys)
    _, level = grid.levels
    assert level.down is not None
    assert level.up is not None
    return [
        (grid.levels[0].neighbours, fine),
        (level.neighbours, coarse),
        (level.down, fine),
        (level.up, coarse),
    ]


@pytest.mark.parametrize(("i", "o"), [(4, 3), (1, 1), (7, 5)])
def test_convolution_is_the_naive_one(i: int, o: int) -> None:
    for kernel_map, rows in maps(VoxelGrid.from_points(cloud(200), 0.05, 2)):
        kernel = random(len(kernel_map.source), i, o)
        x = random(rows, i)
        expected = reference.sparse_convolution(x.numpy(), kernel.numpy(), pairs(kernel_map), kernel_map.outputs)
        np.testing.assert_allclose(sparse_convolution(x, kernel, kernel_map), expected, atol=1e-12)


def test_convolution_on_a_full_block_is_dense_convolution() -> None:
    cells = torch.cartesian_prod(*[torch.arange(4.0)] * 3)  # (64, 3), sorted by x, y, z like the voxels
    grid = VoxelGrid.from_points(cells, 1.0, 1)
    x, kernel = random(64, 2), random(27, 2, 3)
    weight = kernel.view(3, 3, 3, 2, 3).permute(4, 3, 2, 1, 0)  # (out, in, x, y, z) of [z, y, x, in, out]
    dense = torch.nn.functional.conv3d(x.view(4, 4, 4, 2).permute(3, 0, 1, 2)[None], weight, padding=1)
    expected = dense[0].permute(1, 2, 3, 0).reshape(64, 3)
    torch.testing.assert_close(sparse_convolution(x, kernel, grid.levels[0].neighbours), expected)


def test_gradients_of_the_convolutions() -> None:
    for kernel_map, rows in maps(VoxelGrid.from_points(cloud(12, extent=0.1), 0.05, 2)):
        inputs = (random(rows, 2).requires_grad_(), random(len(kernel_map.source), 2, 3).requires_grad_())
        assert torch.autograd.gradcheck(lambda x, k, m=kernel_map: sparse_convolution(x, k, m), inputs)


def test_gradients_of_the_transfers() -> None:
    grid = VoxelGrid.from_points(cloud(12, extent=0.1), 0.05, 2)
    level = grid.levels[1]
    x, z = random(len(level.keys), 2).requires_grad_(), random(len(grid.first), 2).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: voxels_to_points(x, grid.corners(1)), x)
    assert torch.autograd.gradcheck(lambda z: points_to_voxels(z, level.ancestor, len(level.keys)), z)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_interpolation_is_the_naive_one(n: int) -> None:
    xyz = cloud(200)
    grid = VoxelGrid.from_points(xyz, 0.05, 3)
    x = random(len(grid.levels[n].keys), 3)
    expected = reference.Voxels(xyz.numpy(), 0.05, 3).corners(n) @ x.numpy()
    np.testing.assert_allclose(voxels_to_points(x, grid.corners(n)), expected, atol=1e-6)


def test_interpolation_of_a_constant_is_the_constant() -> None:
    grid = VoxelGrid.from_points(cloud(200), 0.05, 4)
    points = voxels_to_points(torch.full((len(grid.levels[3].keys), 2), 7.0), grid.corners(3))
    torch.testing.assert_close(points, torch.full_like(points, 7.0))


def test_mean_is_over_the_points_of_a_voxel() -> None:
    z, row = random(50, 3), torch.arange(50) % 7
    expected = torch.stack([z[row == v].mean(0) for v in range(7)])
    torch.testing.assert_close(points_to_voxels(z, row, 7), expected)


@pytest.mark.parametrize(("volume", "shape"), [(27, (27, 5, 6)), (8, (8, 5, 6)), (1, (5, 6))])
def test_kernel_shapes_are_the_published_ones(volume: int, shape: tuple[int, ...]) -> None:
    conv = SparseConv(5, 6, volume)
    assert conv.kernel.shape == shape
    assert conv.kernel.abs().max() <= (5 * volume) ** -0.5
    assert [name for name, _ in conv.named_parameters()] == ["kernel"]


def test_pointwise_convolution_is_a_product() -> None:
    conv, x = SparseConv(5, 6, 1).double(), random(9, 5)
    torch.testing.assert_close(conv(x), x @ conv.kernel)


def test_empty_input() -> None:
    grid = VoxelGrid.from_points(torch.empty(0, 3), 0.05, 2)
    for kernel_map, _ in maps(grid):
        x = torch.zeros(0, 4, requires_grad=True)
        kernel = torch.zeros(len(kernel_map.source), 4, 3, requires_grad=True)
        out = sparse_convolution(x, kernel, kernel_map)
        assert out.shape == (0, 3)
        out.sum().backward()
        assert kernel.grad is not None
        assert not kernel.grad.any()
    assert voxels_to_points(torch.zeros(0, 4), grid.corners(1)).shape == (0, 4)
    assert points_to_voxels(torch.zeros(0, 4), grid.inverse, 0).shape == (0, 4)

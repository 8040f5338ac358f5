import numpy as np
import pytest
import torch

from mos_model.networks.voxels import BATCH_LIMIT, KernelMap, VoxelGrid
from runtime.errors import ScanError
from tests.support import published
from tests.support import reference_network as reference


def cloud(count: int, seed: int = 0, extent: float = 0.4) -> torch.Tensor:
    """Points in whole millimetres around the origin, with ties of the rounding and duplicates."""
    rng = np.random.default_rng(seed)
    xyz = np.round(rng.uniform(-extent, extent, (count, 3)) * [1, 1, 0.3], 3)
    xyz[::7] = xyz[:1]
    xyz[3::7, 0] = 0.025 * rng.integers(-9, 9, len(xyz[3::7]))
    return torch.from_numpy(xyz.astype(np.float32))


def pairs(kernel_map: KernelMap) -> list[set[tuple[int, int]]]:
    """The pairs (input row, output row) of every offset."""
    sets = []
    for source, target in zip(kernel_map.source, kernel_map.target, strict=True):
        rows = range(kernel_map.outputs)
        sources = rows if source is None else source.tolist()
        targets = rows if target is None else target.tolist()
        assert len(sources) == len(targets)
        sets.append(set(zip(sources, targets, strict=True)))
        assert len(sets[-1]) == len(targets) == len(set(targets)) == len(set(sources))
    return sets


@pytest.mark.parametrize(("count", "seed"), [(1, 0), (2, 1), (400, 2), (400, 3)])
def test_voxels_are_the_naive_ones(count: int, seed: int) -> None:
    xyz = cloud(count, seed)
    grid, naive = VoxelGrid.from_points(xyz, 0.05, 4), reference.Voxels(xyz.numpy(), 0.05, 4)
    assert grid.inverse.tolist() == [naive.rows[0][point] for point in naive.points]
    assert grid.first.tolist() == [naive.points.index(voxel) for voxel in naive.rows[0]]
    for n, level in enumerate(grid.levels):
        assert level.stride == 2**n
        assert len(level.keys) == len(naive.rows[n])
        assert level.ancestor.tolist() == [naive.rows[n][reference.floor(v, 2**n)] for v in naive.rows[0]]


@pytest.mark.parametrize("seed", [2, 3])
def test_kernel_maps_are_the_naive_ones(seed: int) -> None:
    xyz = cloud(300, seed)
    grid, naive = VoxelGrid.from_points(xyz, 0.05, 5), reference.Voxels(xyz.numpy(), 0.05, 5)
    for n, level in enumerate(grid.levels):
        assert pairs(level.neighbours) == naive.neighbours(n)
        if n == 0:
            assert level.down is None
            assert level.up is None
            continue
        down = naive.down(n)
        assert pairs(level.down) == down
        assert pairs(level.up) == [{(o, i) for i, o in of_offset} for of_offset in down]
        assert (level.down.outputs, level.up.outputs) == (len(naive.rows[n]), len(naive.rows[n - 1]))


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_corners_are_the_naive_ones(n: int) -> None:
    xyz = cloud(300, 4)
    row, weight = VoxelGrid.from_points(xyz, 0.05, 4).corners(n)
    expected = reference.Voxels(xyz.numpy(), 0.05, 4).corners(n)
    matrix = torch.zeros(expected.shape).scatter_add_(1, row, weight)
    np.testing.assert_allclose(matrix, expected, atol=1e-6)


def test_rounding_is_float32_and_half_to_even() -> None:
    xyz = published.reference_output("point_head_full")["xyz"]
    q = np.round(xyz.numpy() / np.float32(0.05)).astype(np.int64)
    _, inverse = np.unique(q, axis=0, return_inverse=True)
    np.testing.assert_array_equal(VoxelGrid.from_points(xyz, 0.05, 1).inverse, inverse.reshape(-1))


def test_scans_of_a_batch_do_not_meet() -> None:
    scans = [cloud(150, 5), cloud(200, 6) + 100, cloud(1, 7), cloud(150, 5)]
    batch = torch.cat([torch.full((len(scan),), i) for i, scan in enumerate(scans)])
    together = VoxelGrid.from_points(torch.cat(scans), 0.05, 3, batch)
    alone = [VoxelGrid.from_points(scan, 0.05, 3) for scan in scans]
    for n, level in enumerate(together.levels):
        counts = [len(grid.levels[n].keys) for grid in alone]
        assert len(level.keys) == sum(counts)
        starts = np.cumsum([0, *counts])
        expected = [
            {(i + start, o + start) for grid, start in zip(alone, starts, strict=False) for i, o in of_offset[grid]}
            for of_offset in _by_grid(alone, n)
        ]
        assert pairs(level.neighbours) == expected


def _by_grid(grids: list[VoxelGrid], n: int) -> list[dict[VoxelGrid, set[tuple[int, int]]]]:
    maps = [pairs(grid.levels[n].neighbours) for grid in grids]
    return [dict(zip(grids, of_offset, strict=True)) for of_offset in zip(*maps, strict=True)]


def test_scans_of_a_batch_may_be_interleaved() -> None:
    xyz, batch = cloud(200, 8), torch.arange(200) % 3
    grid = VoxelGrid.from_points(xyz, 0.05, 2, batch)
    for i in range(3):
        alone = VoxelGrid.from_points(xyz[batch == i], 0.05, 2)
        rows = grid.inverse[batch == i]
        np.testing.assert_array_equal(rows - rows.min(), alone.inverse)


def test_a_grid_that_stands_still() -> None:
    """A point that lies lower than all others shifts none of theirs, at no stride."""
    xyz, size = cloud(300, 9), torch.tensor(0.05)
    cells = (xyz / size).round().long()
    for low in (0.0, 0.3, 0.31):
        grid = VoxelGrid.from_points(torch.cat([xyz, xyz.amin(0, keepdim=True) - low]), 0.05, 3, still=True)
        for level in grid.levels:
            _, wanted = torch.unique(cells.div(level.stride, rounding_mode="floor"), dim=0, return_inverse=True)
            rows = level.ancestor[grid.inverse[:-1]]
            assert len(set(zip(rows.tolist(), wanted.tolist(), strict=True))) == len(set(wanted.tolist()))


def test_empty_scan() -> None:
    grid = VoxelGrid.from_points(torch.empty(0, 3), 0.05, 3)
    assert [len(level.keys) for level in grid.levels] == [0, 0, 0]
    assert grid.corners(2).row.shape == (0, 8)
    assert pairs(grid.levels[1].neighbours) == [set()] * 27


def test_far_from_the_origin() -> None:
    xyz = torch.tensor([[1e6, -1e6, 0.0], [1e6, -1e6, 0.05], [1e6, -1e6, 3000.0]])
    grid = VoxelGrid.from_points(xyz, 0.05, 5)
    assert len(grid.first) == 3
    assert sum(len(s) for s in pairs(grid.levels[0].neighbours)) == 3 + 2


def test_widest_scan_has_no_false_neighbours() -> None:
    last = (1 << 18) - (1 << 5) - 1  # the last voxel that is allowed with five levels
    corners = torch.tensor([[x, y, z] for x in (0, last) for y in (0, last) for z in (0, last)], dtype=torch.float32)
    grid = VoxelGrid.from_points(corners, 1.0, 5, None)
    for n, level in enumerate(grid.levels):
        assert [len(s) for s in pairs(level.neighbours)] == [0] * 13 + [8] + [0] * 13
        np.testing.assert_allclose(grid.corners(n).weight.sum(1), 1)
    with pytest.raises(ScanError, match="spreads over"):
        VoxelGrid.from_points(corners + (corners > 0), 1.0, 5)


@pytest.mark.parametrize(
    ("xyz", "batch", "message"),
    [
        (torch.tensor([[0, 0, float("nan")]]), None, "finite"),
        (torch.tensor([[0, float("inf"), 0]]), None, "finite"),
        (torch.tensor([[0, 0, 0], [3e37, 0, 0]]), None, "within"),
        (torch.tensor([[0, 0, 0], [0, 0, 20e3]]), None, "spreads over 400000"),
        (torch.zeros(4, 4), None, r"\(N, 3\)"),
        (torch.zeros(4, 3, dtype=torch.int64), None, "floats"),
        (torch.zeros(4, 3), torch.zeros(3, dtype=torch.int64), "batch must be"),
        (torch.zeros(4, 3), torch.zeros(4), "batch must be"),
        (torch.zeros(1, 3), torch.tensor([BATCH_LIMIT]), "smaller batches"),
        (torch.zeros(1, 3), torch.tensor([-1]), "smaller batches"),
    ],
)
def test_bad_input(xyz: torch.Tensor, batch: torch.Tensor | None, message: str) -> None:
    with pytest.raises(ScanError, match=message):
        VoxelGrid.from_points(xyz, 0.05, 5, batch)


def test_points_are_not_written_and_need_no_layout() -> None:
    xyz = cloud(100, 9).repeat_interleave(2, 1)[:, ::2]
    before = xyz.clone()
    strided = VoxelGrid.from_points(xyz, 0.05, 2)
    torch.testing.assert_close(xyz, before)
    assert torch.equal(strided.inverse, VoxelGrid.from_points(before, 0.05, 2).inverse)

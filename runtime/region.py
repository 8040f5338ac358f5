"""Which voxels a refinement has to look at: the surroundings of the voxels that may move."""

import numpy as np
from numpy.typing import NDArray

from runtime.arena import Arena
from runtime.head_config import PointHeadConfig
from runtime.jit import kernel
from runtime.kernel_map import build_scales, neighbours
from runtime.workers import Workers

_BLOCK = 2  # level of the blocks (2^2 voxels wide) that are kept or dropped as a whole
_GRAIN = 256  # cells per task


def receptive_field(config: PointHeadConfig) -> int:
    """Greatest distance per axis, in voxels, between a voxel and those that its result depends on."""
    return max(_reach(config, place) for place in range(1 << len(config.down)))


def _reach(config: PointHeadConfig, place: int) -> int:
    """The same for a voxel at `place` in the coarsest grid, on one axis: from the output backwards."""
    depth = len(config.down)
    voxels = points = (place, place)  # first and last position needed of each branch

    def aligned(box: tuple[int, int], stride: int, beyond: int = 0) -> tuple[int, int]:
        return (box[0] // stride - beyond) * stride, (box[1] // stride + beyond) * stride + stride - 1

    def union(a: tuple[int, int], b: tuple[int, int]) -> tuple[int, int]:
        return min(a[0], b[0]), max(a[1], b[1])

    def exchanged(stride: int) -> tuple[tuple[int, int], tuple[int, int]]:
        both = union(voxels, points)
        return (both[0] // stride * stride, (both[1] // stride + 2) * stride - 1), both

    skips = {}
    for stage in range(depth, 0, -1):  # decoder
        stride = 1 << (depth - stage)
        if stage == config.fuse_after_up:
            voxels, points = exchanged(stride)
        voxels = skips[depth - stage] = aligned(voxels, stride, 4)
        voxels = aligned(voxels, 2 * stride)
    voxels, points = exchanged(1 << depth)
    for level in range(depth, 0, -1):  # encoder
        voxels = aligned(aligned(voxels, 1 << level, 4), 1 << level)
        voxels = union(voxels, skips[level - 1])
    low, high = aligned(union(voxels, points), 1, 1)
    return max(place - low, high - place)


def surroundings(
    keys: NDArray[np.int64], candidates: NDArray[np.bool_], reach: int, arena: Arena, workers: Workers
) -> NDArray[np.int32]:
    """Rows, rising, of all voxels within `reach` voxels (on each axis) of a candidate, and some farther ones.

    `keys` (V,) rising Morton keys, V >= 1; `candidates` (V,) bool. Blocks of 4^3 voxels are kept as a whole.
    Each block is compared with the candidate blocks in the 27 cells around it, cells at least as wide as the
    reach.
    """
    blocks_apart = (reach - 1 >> _BLOCK) + 1 if reach else 0
    cell = _BLOCK + max(0, blocks_apart - 1).bit_length()
    scales = build_scales(keys, cell, arena, "region.")
    cell = min(cell, len(scales) - 1)
    table = neighbours(scales, cell, arena, workers, "region.")[cell]
    members = scales[1].starts[scales[2].starts]  # voxels of each block
    wanted = np.logical_or.reduceat(candidates, members[:-1])
    coords = _coordinates(scales[_BLOCK].keys)
    ranges = np.arange(len(members), dtype=np.int32)  # blocks of each cell
    for level in range(_BLOCK + 1, cell + 1):
        ranges = ranges[scales[level].starts]
    near = wanted.copy()
    before = np.concatenate(([0], np.cumsum(wanted))).astype(np.int32)[ranges]
    targets = coords[wanted]
    workers.ranges(
        lambda a, b: _near(coords, ranges, targets, before, table, blocks_apart, near, a, b),
        len(ranges) - 1,
        _GRAIN,
    )
    return np.flatnonzero(np.repeat(near, np.diff(members))).astype(np.int32)


@kernel
def _coordinates(keys):  # type: ignore[no-untyped-def]
    coords = np.empty((keys.size, 3), np.int32)
    for i in range(keys.size):
        coords[i, 0] = coords[i, 1] = coords[i, 2] = 0
        for bit in range(21):
            octant = keys[i] >> 3 * bit & 7
            coords[i, 0] |= (octant >> 2) << bit
            coords[i, 1] |= (octant >> 1 & 1) << bit
            coords[i, 2] |= (octant & 1) << bit
    return coords


@kernel
def _near(coords, ranges, targets, target_ranges, table, apart, near, start, stop):  # type: ignore[no-untyped-def]
    cells = table.shape[0] - 1
    for c in range(start, stop):
        for k in range(27):
            other = table[c, k]
            if other == cells or target_ranges[other] == target_ranges[other + 1]:
                continue
            for b in range(ranges[c], ranges[c + 1]):
                j = target_ranges[other]
                while not near[b] and j < target_ranges[other + 1]:
                    near[b] = (
                        abs(coords[b, 0] - targets[j, 0]) <= apart
                        and abs(coords[b, 1] - targets[j, 1]) <= apart
                        and abs(coords[b, 2] - targets[j, 2]) <= apart
                    )
                    j += 1

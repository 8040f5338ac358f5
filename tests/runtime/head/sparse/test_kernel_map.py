"""Scales, neighbour tables and kernel maps against dictionaries of voxels."""

from itertools import pairwise

import numpy as np
import pytest

from runtime.compute.arena import Arena
from runtime.compute.workers import Workers
from runtime.head.sparse.kernel import UNIT
from runtime.head.sparse.kernel_map import build_scales, neighbours, table_map, up_map
from runtime.head.voxels import voxelise
from tests.support import reference_voxels as reference

CLOUDS = {
    "surfaces": reference.surfaces(1, 600),
    "dense": np.random.default_rng(2).uniform(0.1, 0.6, (900, 3)).astype(np.float32),
    "far apart": np.random.default_rng(3).uniform(-9e4, 1e4, (40, 3)).astype(np.float32),
    "one": np.ones((1, 3), np.float32),
    "line": np.linspace((1, 1, 1), (9, 1, 1), 200).astype(np.float32),
}


def scales_of(name, depth=3, threads=2):
    voxels = voxelise(CLOUDS[name], 0.05, Workers(threads))
    return voxels, build_scales(voxels.keys, depth, Arena())


def coordinates(scales, voxels):
    """Coordinates of each scale's voxels, in units of that scale, from the finest one's."""
    coords = [[tuple(c) for c in voxels.coords.tolist()]]
    for scale in scales[1:]:
        coords.append([tuple(c // 2 for c in coords[-1][first]) for first in scale.starts[:-1]])
    return coords


def pairs(kernel_map):
    """{(offset, input row, output row)}; also checks how the runs are filled up."""
    found = []
    for t, row in enumerate(kernel_map.starts):
        for k, (begin, end) in enumerate(pairwise(row)):
            assert (end - begin) % UNIT == 0
            assert end - begin != UNIT
            inputs, outputs = kernel_map.inputs[begin:end], kernel_map.outputs[begin:end]
            real = outputs < kernel_map.tile
            assert (inputs[~real] == 0).all()
            assert (outputs[~real] == kernel_map.tile).all()
            assert end - begin == real.sum() == 0 or end - begin - real.sum() < 2 * UNIT
            found += [
                (k, int(i), t * kernel_map.tile + int(o)) for i, o in zip(inputs[real], outputs[real], strict=True)
            ]
    assert len(found) == len(set(found)) == kernel_map.pairs
    return set(found)


@pytest.mark.parametrize("name", CLOUDS)
def test_scales(name):
    voxels, scales = scales_of(name)
    assert len(scales[-1].keys) == 1
    assert len(scales) >= 4
    for level, coords in enumerate(coordinates(scales, voxels)):
        expected = {tuple(c >> level for c in voxel) for voxel in voxels.coords.tolist()}
        assert len(coords) == len(expected)
        assert set(coords) == expected
    for fine, coarse in pairwise(scales):
        rows = np.arange(len(fine.keys))
        assert np.array_equal(coarse.keys[fine.parent], fine.keys >> 3)
        assert np.array_equal(np.repeat(np.arange(len(coarse.keys)), np.diff(coarse.starts)), fine.parent)
        assert np.array_equal(coarse.child[fine.parent, fine.keys & 7], rows)
        assert (coarse.child < len(rows)).sum() == len(rows)


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("threads", [1, 2])
def test_neighbours(name, threads):
    voxels, scales = scales_of(name, threads=threads)
    tables = neighbours(scales, 0, Arena(), Workers(threads))
    for coords, table in zip(coordinates(scales, voxels), tables, strict=True):
        rows = {voxel: i for i, voxel in enumerate(coords)}
        for i, voxel in enumerate(coords):
            for k, offset in enumerate(reference.CUBE3):
                assert table[i, k] == rows.get(reference.shifted(voxel, offset, 1), len(coords))
        assert (table[-1] == len(coords)).all()


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("threads", [1, 2])
def test_kernel_maps(name, threads):
    workers = Workers(threads)
    voxels, scales = scales_of(name)
    tables = neighbours(scales, 0, Arena(), workers)
    coords = coordinates(scales, voxels)
    for level, here in enumerate(coords[:-1]):
        rows = {voxel: i for i, voxel in enumerate(here)}
        expected = {
            (k, rows[other], o)
            for o, voxel in enumerate(here)
            for k, offset in enumerate(reference.CUBE3)
            if (other := reference.shifted(voxel, offset, 1)) in rows
        }
        found = table_map(tables[level], len(here), Arena(), workers, "same")
        assert pairs(found) == expected
        above = {voxel: i for i, voxel in enumerate(coords[level + 1])}
        family = {
            (reference.CUBE2.index(tuple(c % 2 for c in voxel)), i, above[tuple(c // 2 for c in voxel)])
            for i, voxel in enumerate(here)
        }
        assert pairs(table_map(scales[level + 1].child, len(here), Arena(), workers, "down")) == family
        up = up_map(scales[level], len(above), Arena(), workers, "up")
        assert pairs(up) == {(k, coarse, fine) for k, fine, coarse in family}
        assert (up.count_in, up.count_out) == (len(above), len(here))


def test_several_tiles():
    """Far more voxels than a tile holds, and a workspace that is used again for fewer."""
    rng = np.random.default_rng(5)
    workers, arena = Workers(2), Arena()
    for count in (9000, 2000):
        voxels = voxelise(rng.uniform(0.1, 1.5, (count, 3)).astype(np.float32), 0.05, workers)
        scales = build_scales(voxels.keys, 2, arena)
        table = neighbours(scales, 0, arena, workers)[0]
        found = table_map(table, len(voxels.keys), arena, workers, "same")
        assert len(found.starts) > 4
        o, k = np.nonzero(table[:-1] < len(voxels.keys))
        assert pairs(found) == set(zip(k.tolist(), table[o, k].tolist(), o.tolist(), strict=True))
    held = arena.nbytes
    table_map(table, len(voxels.keys), arena, workers, "same")
    assert arena.nbytes == held

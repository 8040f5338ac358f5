"""Voxelisation against a dictionary of voxels."""

import numpy as np
import pytest

from runtime.compute.workers import Workers
from runtime.errors import ScanError
from runtime.head.voxels import voxelise
from tests.support import reference_voxels as reference

SIZE = 0.05


def check(xyz, valid=None, threads=2, size=SIZE, step=1):
    """Compare with the reference, voxel by voxel."""
    found = voxelise(xyz, size, Workers(threads), valid, step=step)
    xyz = np.array(xyz)
    used = np.ones(len(xyz), bool) if valid is None else np.array(valid)
    voxels, inverse, first = reference.voxelise(np.where(used[:, None], xyz, 0), size, used, step)
    order = {tuple(voxel): i for i, voxel in enumerate(found.coords.tolist())}
    assert sorted(order) == sorted(voxels)
    assert (np.diff(found.keys) > 0).all()
    rows = np.array([order[voxel] for voxel in voxels], np.int64)
    assert np.array_equal(found.first[rows], first)
    assert np.array_equal(found.inverse, np.where(inverse >= 0, rows[inverse] if len(rows) else -1, -1))
    for v in range(len(found.keys)):
        assert np.array_equal(found.order[found.starts[v] : found.starts[v + 1]], np.flatnonzero(found.inverse == v))
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("threads", [1, 3])
def test_like_the_reference(seed, threads):
    check(reference.surfaces(seed, 700), threads=threads)


@pytest.mark.parametrize("step", [2, 4, 16])
def test_a_grid_that_stands_still(step):
    """Whatever lies lowest, the others keep their places in it."""
    xyz = reference.surfaces(1, 500)
    cells = np.round(xyz / np.float32(SIZE))
    for low in (0.0, 0.01, 0.3, 7.77):
        found = check(np.vstack([xyz, xyz.min(axis=0) - np.float32(low)]), step=step)
        places = found.coords[found.inverse[:-1]]
        assert (places.min(axis=0) >= 0).all()
        assert ((places - cells) % step == 0).all()


def test_several_tasks():
    """More points than one task takes: first points and order run across tasks."""
    rng = np.random.default_rng(1)
    xyz = rng.uniform(-0.2, 0.2, (70_000, 3)).astype(np.float32)
    found = check(xyz)
    assert len(found.keys) <= 9**3


def test_ties_go_to_even_in_float32():
    xyz = np.array([[0.025, 0.075, 0.125], [0.175, -0.025, -0.075], [1.175, 1.225, 3.275]], np.float32)
    expected = np.round(xyz / np.float32(0.05))
    found = voxelise(xyz, 0.05, Workers(1))
    assert np.array_equal(found.coords[found.inverse], expected - expected.min(axis=0))
    assert not np.array_equal(expected, np.round(xyz.astype(np.float64) * 20))  # else the case shows nothing


def test_points_that_are_left_out_do_not_count_for_the_minimum():
    xyz = np.array([[0, 0, 0], [5, 5, 5], [np.nan, -9, 1], [6, np.inf, 5], [5.2, 5, 5], [-8, -8, -8]], np.float32)
    found = check(xyz, np.array([False, True, False, False, True, False]))
    assert found.inverse.tolist() == [-1, 0, -1, -1, 1, -1]
    assert found.coords.tolist() == [[0, 0, 0], [4, 0, 0]]


def test_nothing_and_one_voxel():
    found = check(np.zeros((0, 3), np.float32))
    assert found.keys.shape == (0,)
    assert found.starts.tolist() == [0]
    assert check(np.zeros((4, 3), np.float32), np.zeros(4, bool)).inverse.tolist() == [-1] * 4
    found = check(np.full((5, 3), 2.5, np.float32))
    assert found.first.tolist() == [0]
    assert found.coords.tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("reach", [0, 1, 5, 9, 40])
@pytest.mark.parametrize("shift", [0.0, -3.0, 210.0])  # 210 m: another place in the table of marks
def test_near_candidates(reach, shift):
    """Blocks of 4^3 voxels that are within reach of a candidate are as in the whole scan; the rest is left out."""
    xyz = reference.surfaces(reach, 900, 9.0) + np.float32(shift)
    candidates = np.zeros(900, bool)
    candidates[[5, 300]] = True
    whole, part = voxelise(xyz, SIZE, Workers(2)), voxelise(xyz, SIZE, Workers(2), None, (candidates, reach))
    lowest, near = whole.coords[:, None] // 4 * 4, whole.coords[whole.inverse[candidates]]
    apart = np.maximum(lowest - near, near - (lowest + 3)).max(axis=2).min(axis=1)  # of a block, from the nearest
    assert np.array_equal(part.keys, whole.keys[apart <= reach])
    assert len(part.keys) < len(whole.keys)
    rows = np.searchsorted(whole.keys, part.keys)
    assert np.array_equal(part.coords, whole.coords[rows])
    assert np.array_equal(part.first, whole.first[rows])
    assert np.array_equal(np.flatnonzero(part.inverse >= 0), np.flatnonzero(np.isin(whole.inverse, rows)))
    assert np.array_equal(rows[part.inverse[part.inverse >= 0]], whole.inverse[part.inverse >= 0])
    assert len(voxelise(xyz, SIZE, Workers(1), None, (np.zeros(900, bool), reach)).keys) == 0


def test_near_candidates_leaves_out_what_is_above():
    """Distance counts on each axis, and candidates that do not take part mark nothing."""
    height = np.arange(0.0, 6.0, SIZE, dtype=np.float32)  # less than the marks' height, after which they repeat
    xyz = np.stack([np.full_like(height, 7), np.full_like(height, -2), height - 3], axis=1)
    candidates = np.arange(len(xyz)) == 60
    part = voxelise(xyz, SIZE, Workers(1), None, (candidates, 4))
    assert np.array_equal(np.flatnonzero(part.inverse >= 0), np.arange(56, 68))  # whole blocks of 4 voxels
    assert len(voxelise(xyz, SIZE, Workers(1), ~candidates, (candidates, 4)).keys) == 0


@pytest.mark.parametrize("reach", [1000, 1 << 40])
def test_a_reach_beyond_the_marks_keeps_everything(reach):
    xyz = reference.surfaces(2, 300, 9.0)
    part = voxelise(xyz, SIZE, Workers(2), None, (np.arange(300) == 7, reach))
    assert np.array_equal(part.keys, voxelise(xyz, SIZE, Workers(2)).keys)


def test_read_only_and_strided_arrays():
    xyz = reference.surfaces(3, 300)
    wide = np.zeros((300, 4), np.float32)
    wide[:, :3] = xyz
    frozen = xyz.copy()
    frozen.flags.writeable = False
    for other in (wide[:, :3], np.asfortranarray(xyz), frozen, xyz.astype(np.float64)):
        assert np.array_equal(voxelise(other, SIZE, Workers(1)).inverse, voxelise(xyz, SIZE, Workers(1)).inverse)


def test_range_of_the_keys():
    most = float(2**21 - 1)
    xyz = np.array([[0, 0, 1], [most, 0, 1], [0, most, 1], [3, 4, most + 1]], np.float32)
    assert check(xyz, size=1.0).coords.max() == 2**21 - 1
    xyz[1, 0] += 1
    with pytest.raises(ScanError, match="spans"):
        voxelise(xyz, 1.0, Workers(1))
    with pytest.raises(ScanError, match="spans"):  # beyond what 32 bits count, though all in one place
        voxelise(np.full((3, 3), 3e9, np.float32), 1.0, Workers(1))


def test_wrong_shapes():
    with pytest.raises(ScanError, match=r"\(N, 3\)"):
        voxelise(np.zeros((4, 4), np.float32), SIZE, Workers(1))
    with pytest.raises(ScanError, match="mask"):
        voxelise(np.zeros((4, 3), np.float32), SIZE, Workers(1), np.ones(3, bool))
    for near in ((np.ones(5, bool), 1), (np.ones(4, bool), -1)):
        with pytest.raises(ScanError, match=r"near must be a mask \(4,\) and a distance"):
            voxelise(np.zeros((4, 3), np.float32), SIZE, Workers(1), None, near)

"""What is kept of past scans, against dictionaries without a limit and sets without a hash."""

import numpy as np
import pytest

from runtime.belief.memory import SETS, WAYS, Memory
from runtime.compute.hashing import hash_of
from runtime.compute.jit import kernel
from runtime.compute.workers import Workers
from tests.support import reference_belief as reference

HORIZON = 5


@kernel
def lower_bits(key, mask):
    return hash_of(key) & mask


def set_of(sets):
    return lambda key: int(lower_bits(np.int64(key), np.uint64(sets - 1)))


def drives(seed, scans, most=400, keys=600):
    """For each scan keys, none twice, and evidence."""
    rng = np.random.default_rng(seed)
    world = rng.integers(0, 1 << 63, keys)
    for _ in range(scans):
        seen = rng.permutation(world)[: rng.integers(0, most)]
        yield seen, rng.uniform(-9.2, 9.2, len(seen)).astype(np.float32)


def numbers(keys):
    return np.array(keys, np.int64)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("horizon", [1, HORIZON, 16])
def test_like_a_dictionary_while_there_is_room(horizon, threads):
    memory, past = Memory(horizon, Workers(threads)), []
    for keys, evidence in drives(horizon, 40):
        want = reference.recalled(past, horizon)
        np.testing.assert_allclose(
            memory.recall(keys), [want.get(key, 0) for key in keys.tolist()], atol=horizon / 4096
        )
        memory.add(keys, evidence)
        past.append(dict(zip(keys.tolist(), evidence.tolist(), strict=True)))


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("sets", [1, 2, 16])
def test_where_sets_are_full_the_oldest_give_way(sets, threads):
    memory, want = Memory(HORIZON, Workers(threads), sets), reference.Sets(HORIZON, WAYS, set_of(sets))
    for keys, evidence in drives(sets, 40, most=12 * sets, keys=20 * sets):
        np.testing.assert_allclose(memory.recall(keys), [want.recall(key) for key in keys.tolist()], atol=1e-2)
        memory.add(keys, evidence)
        want.add(keys.tolist(), evidence.tolist())


@pytest.mark.parametrize("sets", [2, SETS])
def test_older_scans_leave_no_bit(sets):
    """What is recalled after `HORIZON` scans is the same whatever was before, full sets or not."""
    scans = list(drives(3, 60, most=30, keys=40))
    memory = Memory(HORIZON, Workers(2), sets)
    for i, (keys, evidence) in enumerate(scans):
        fresh = Memory(HORIZON, Workers(1), sets)
        for earlier in scans[max(0, i - HORIZON) : i]:
            fresh.add(*earlier)
        np.testing.assert_array_equal(memory.recall(keys), fresh.recall(keys))
        memory.add(keys, evidence)


def test_voxels_of_one_hash_are_told_apart():
    sets = 64
    keys = [key for key in range(20_000) if set_of(sets)(key) == 7][:WAYS]
    assert len(keys) == WAYS
    memory = Memory(HORIZON, Workers(1), sets)
    memory.add(numbers(keys), np.arange(WAYS, dtype=np.float32))
    np.testing.assert_array_equal(memory.recall(numbers(keys)), np.arange(WAYS))


def test_one_scan_that_fills_a_set_keeps_the_first():
    memory = Memory(HORIZON, Workers(1), sets=1)
    keys = numbers(range(100, 100 + 2 * WAYS))
    memory.add(keys, np.ones(len(keys), np.float32))
    np.testing.assert_array_equal(memory.recall(keys), [1] * WAYS + [0] * WAYS)


def test_evidence_is_dropped_scan_by_scan():
    memory, key, nothing = Memory(3, Workers(1)), numbers([5]), np.empty(0, np.float32)
    memory.add(key, np.array([1], np.float32))
    memory.add(key, np.array([2], np.float32))
    for want in (3, 3, 2, 0, 0):
        assert memory.recall(key) == want
        memory.add(key[:0], nothing)
    memory.add(key, np.array([-4], np.float32))
    assert memory.recall(key) == -4


def test_nothing_asked_and_nothing_known():
    memory = Memory(HORIZON, Workers(2))
    assert memory.recall(numbers([])).shape == (0,)
    np.testing.assert_array_equal(memory.recall(numbers([0, 1, 2**63 - 1])), 0)
    memory.add(numbers([0, 2**63 - 1]), np.array([1, -1], np.float32))
    np.testing.assert_array_equal(memory.recall(numbers([0, 1, 2**63 - 1])), [1, 0, -1])
    memory.clear()
    np.testing.assert_array_equal(memory.recall(numbers([0, 2**63 - 1])), 0)


def test_memory_is_bounded():
    held = Memory(16, Workers(1)).nbytes
    assert held < 20e6
    memory = Memory(16, Workers(1), sets=4)
    before = memory.nbytes
    for keys, evidence in drives(9, 50):
        memory.add(keys, evidence)
    assert memory.nbytes == before

"""The hash of 64-bit keys in compiled tables."""

import numpy as np

from runtime.compute.jit import inlined


@inlined
def hash_of(key):  # type: ignore[no-untyped-def]
    """An uint64 whose lower 32 bits depend on all of an int64 (multiplicative hashing, golden ratio)."""
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return mixed ^ mixed >> np.uint64(32)


@inlined
def slot_of(slots, keys, key):  # type: ignore[no-untyped-def]
    """Where `key` stands in a table, or would: slots (2^k,) int32 number `keys`; below 0 they are free, some always."""
    last = np.uint64(slots.size - 1)
    slot = hash_of(key) & last
    while slots[slot] >= 0 and keys[slots[slot]] != key:
        slot = slot + np.uint64(1) & last
    return slot

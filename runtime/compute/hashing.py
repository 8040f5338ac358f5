"""The hash of 64-bit keys in compiled tables."""

import numpy as np

from runtime.compute.jit import inlined


@inlined
def hash_of(key):  # type: ignore[no-untyped-def]
    """An uint64 whose lower 32 bits depend on all of an int64 (multiplicative hashing, golden ratio)."""
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return mixed ^ mixed >> np.uint64(32)

"""What surely moved a moment ago moves still: an object that touches where one was a scan before needs less evidence.

Movers come into view, turn and pass behind others bit by bit; the network then takes them for standing now and then,
and what past scans found at a place (`runtime.belief.memory`) says little of what is elsewhere in each of them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.belief.objects import Objects
from runtime.belief.places import AROUND, neighbour
from runtime.compute.hashing import slot_of
from runtime.compute.jit import kernel


@dataclass(frozen=True)
class Trail:
    """The places of a scan whose objects surely moved in it, or a moment before."""

    keys: NDArray[np.int64]  # (P,)
    age: NDArray[np.int32]  # (P,) scans since; 0: in it


NO_TRAIL = Trail(np.empty(0, np.int64), np.empty(0, np.int32))


def follow(objects: Objects, before: Trail, sure: float, longest: int) -> tuple[Trail, NDArray[np.bool_]]:
    """The trail of a scan, and which of its objects are in it, (P,) at the place that stands for each.

    before: that of the scan before; sure: log-odds above which an object surely moves; longest: scans that the last
    such time may be ago, from object to object that touch.
    """
    age = _follow(
        objects.keys, objects.slots, objects.root, objects.median, before.keys, before.age, sure, longest, AROUND
    )
    kept = age <= longest
    return Trail(objects.keys[kept], age[kept]), kept


@kernel
def _follow(keys, slots, root, median, past, ages, sure, longest, around):  # type: ignore[no-untyped-def]
    """Age (P,) of the object of each place; longest + 1: not in the trail."""
    age = np.full(keys.size, longest + 1, np.int32)
    for node in range(keys.size):
        if root[node] == node and median[node] > sure:
            age[node] = 0
    for p in range(past.size):
        if ages[p] < longest:
            for step in range(around.shape[0]):
                near = slots[slot_of(slots, keys, neighbour(past[p], around[step]))]
                if near >= 0:
                    age[root[near]] = min(age[root[near]], ages[p] + 1)
    for node in range(keys.size):
        age[node] = age[root[node]]
    return age

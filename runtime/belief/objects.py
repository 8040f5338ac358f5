"""One object, one answer: points that may move and lie in places that touch agree on the median of what is believed.

A network sees a vehicle in pieces: its bonnet moves, its roof perhaps, its rear does not; and some leaves of a hedge
move. What touches is one object more often than not, and most of its points are right.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.belief.places import AROUND, Places, neighbour
from runtime.compute.hashing import slot_of
from runtime.compute.jit import inlined, kernel

_NONE = np.int32(-1)
# The half of the 26 places around one from which the other half is looked at
_STEPS = AROUND[14:]


@dataclass(frozen=True)
class Objects:
    """The objects of a scan: P places with points that may move, of which those that touch are one object."""

    keys: NDArray[np.int64]  # (P,) of the places
    slots: NDArray[np.int32]  # their table (`slot_of`)
    root: NDArray[np.int32]  # (P,) the place that stands for the object of each
    points: NDArray[np.int32]  # (Q,) the points
    owner: NDArray[np.int32]  # (Q,) the place that stands for the object of each
    median: NDArray[np.float32]  # (P,) of the log-odds of an object's points, at the place that stands for it


def find_objects(places: Places, log_odds: NDArray[np.float32], least: float) -> Objects:
    """The objects of points that have log-odds (N,) f32 of `least` or more; of an even number the upper median."""
    return Objects(*_find(places.place, places.keys, log_odds, np.float32(least), _STEPS))


def agree(objects: Objects, more: NDArray[np.float32], log_odds: NDArray[np.float32], doubtful: float) -> None:
    """Give the points of every object its median and `more` (P,), in place.

    doubtful: log-odds from which on a point is raised to the median, too. What is surely standing is the ground at its
    wheels.
    """
    _agree(objects.points, objects.owner, objects.median, more, log_odds, np.float32(doubtful))


@inlined
def _root(parent, node):  # type: ignore[no-untyped-def]
    """The node that stands for all that are joined with one; halves the way there."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@inlined
def _select(values, start, stop, k):  # type: ignore[no-untyped-def]
    """What would be at `k` if values[start:stop] were sorted; moves them about (Hoare's quickselect)."""
    while stop - start > 1:
        pivot, left, right = values[(start + stop) // 2], start, stop - 1
        while left <= right:
            while values[left] < pivot:
                left += 1
            while pivot < values[right]:
                right -= 1
            if left <= right:
                values[left], values[right] = values[right], values[left]
                left, right = left + 1, right - 1
        if k <= right:
            stop = right + 1
        elif k >= left:
            start = left
        else:
            break
    return values[k]


@kernel
def _find(place, keys, log_odds, least, steps):  # type: ignore[no-untyped-def]
    """`Objects`, field by field."""
    inside, points = np.empty(place.size, np.int32), 0  # such points
    node_of = np.full(keys.size, _NONE, np.int32)  # of a place
    nodes, count = np.empty(keys.size, np.int64), np.int32(0)  # keys of the places that have such points
    for i in range(place.size):
        if place[i] >= 0 and log_odds[i] >= least:
            inside[points] = i
            points += 1
            if node_of[place[i]] == _NONE:
                node_of[place[i]], nodes[count] = count, keys[place[i]]
                count += np.int32(1)
    size = 1 << 4
    while size < 2 * count:
        size *= 2
    slots = np.full(size, _NONE, np.int32)
    for node in range(count):
        slots[slot_of(slots, nodes, nodes[node])] = node
    parent = np.arange(count, dtype=np.int32)
    for node in range(count):
        for step in range(steps.shape[0]):
            near = slots[slot_of(slots, nodes, neighbour(nodes[node], steps[step]))]
            if near != _NONE:
                one, other = _root(parent, np.int32(node)), _root(parent, near)
                parent[max(one, other)] = min(one, other)
    for node in range(count):
        parent[node] = _root(parent, np.int32(node))
    owner = np.empty(points, np.int32)
    ends = np.zeros(count + 1, np.int64)  # of the points of each object, by its root
    for k in range(points):
        owner[k] = parent[node_of[place[inside[k]]]]
        ends[owner[k] + 1] += 1
    ends = np.cumsum(ends)
    starts, values = ends.copy(), np.empty(points, np.float32)
    for k in range(points):
        values[starts[owner[k]]] = log_odds[inside[k]]
        starts[owner[k]] += 1
    median = np.empty(count, np.float32)
    for root in range(count):
        start, stop = ends[root], ends[root + 1]
        if stop > start:
            median[root] = _select(values, start, stop, (start + stop) // 2)
    return nodes[:count], slots, parent, inside[:points], owner, median


@kernel
def _agree(points, owner, median, more, log_odds, doubtful):  # type: ignore[no-untyped-def]
    for k in range(points.size):
        value = median[owner[k]]
        if log_odds[points[k]] >= min(doubtful, value):
            log_odds[points[k]] = value + more[owner[k]]

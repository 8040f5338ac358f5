"""One object, one answer: points that may move and lie in places that touch agree on the median of what is believed.

A network sees a vehicle in pieces: its bonnet moves, its roof perhaps, its rear does not; and some leaves of a hedge
move. What touches is one object more often than not, and most of its points are right.
"""

import numpy as np
from numpy.typing import NDArray

from runtime.belief.places import Places, neighbour
from runtime.compute.hashing import slot_of
from runtime.compute.jit import inlined, kernel

_NONE = np.int32(-1)
# The half of the 26 places around one that the other halves have not looked from
_STEPS = np.array([s for s in np.ndindex(3, 3, 3) if s > (1, 1, 1)], np.int64) - 1


def agree(places: Places, log_odds: NDArray[np.float32], least: float, doubtful: float) -> None:
    """Give the points of every object the median of its log-odds, in place; of an even number the upper one.

    log_odds: (N,) f32, that a point moves; least: log-odds from which on a point belongs to an object; doubtful: those
    from which on it is raised to the median, too. What is surely standing is the ground at its wheels.
    """
    _agree(places.place, places.keys, log_odds, np.float32(least), np.float32(doubtful), _STEPS)


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
def _agree(place, keys, log_odds, least, doubtful, steps):  # type: ignore[no-untyped-def]
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
    if points == 0:
        return
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
    ends = np.zeros(count + 1, np.int64)  # of the points of each object, by its root
    for i in inside[:points]:
        ends[_root(parent, node_of[place[i]]) + 1] += 1
    ends = np.cumsum(ends)
    starts, values, owner = ends.copy(), np.empty(points, np.float32), np.empty(points, np.int32)
    for i in inside[:points]:
        root = _root(parent, node_of[place[i]])
        values[starts[root]], owner[starts[root]] = log_odds[i], i
        starts[root] += 1
    for root in range(count):
        start, stop = ends[root], ends[root + 1]
        if stop > start:
            median = _select(values, start, stop, (start + stop) // 2)
            for k in range(start, stop):
                if log_odds[owner[k]] >= min(doubtful, median):
                    log_odds[owner[k]] = median

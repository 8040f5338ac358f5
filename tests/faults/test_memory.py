"""One scan of millions of points does not keep its memory for good."""

import numpy as np

from runtime.compute.arena import SPARE, WINDOW, Arena
from runtime.compute.workers import Workers
from runtime.image.entry import Entry
from runtime.image.history import MUCH, History
from runtime.image.history import SPARE as POINTS

LARGE = SPARE // 4 + 1024  # floats


def test_what_was_far_too_large_is_given_back():
    arena = Arena()
    for scan in range(3 * WINDOW):
        arena.next_scan()
        arena.take("x", (LARGE if scan == 0 else 1000,))
        if scan == 0:
            arena.take("only large scans have it", (LARGE,))
            assert arena.nbytes > 2 * SPARE
    assert arena.nbytes < 5000


def test_what_is_needed_now_and_then_stays():
    arena = Arena()
    for scan in range(3 * WINDOW):
        arena.next_scan()
        held = arena.take("x", (LARGE if scan % (WINDOW - 1) == 0 else 1000,))
        if scan == 0:
            place = held.ctypes.data
        assert held.ctypes.data == place


def test_small_ones_stay_whatever_comes():
    arena = Arena()
    for scan in range(3 * WINDOW):
        arena.next_scan()
        arena.take("x", (100_000 if scan == 0 else 10,))
    assert arena.nbytes > 400_000


def test_history_and_entry():
    entry, history = Entry(0.2, 100.0, Workers(1)), History()
    large, small = np.ones((MUCH * POINTS, 4), np.float32), np.ones((10, 4), np.float32)
    history.add(entry.enter(large), np.eye(4), None)
    for _ in range(3 * WINDOW):
        history.add(entry.enter(small), np.eye(4), None)
    held = sum(buffer.nbytes for buffer in history._buffers)
    assert held <= 12 * POINTS
    assert entry._arena.nbytes <= SPARE
    assert len(history.past(np.eye(4))[0].points) == 10

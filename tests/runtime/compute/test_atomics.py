"""Counters shared by threads."""

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

from runtime.compute.atomics import fetch_add, wait_for


@numba.njit(nogil=True)
def take(counter, number):
    return np.array([fetch_add(counter.ctypes.data) for _ in range(number)])


def test_no_two_threads_get_the_same_number():
    counter = np.zeros(1, np.int64)
    with ThreadPoolExecutor(4) as pool:
        taken = np.concatenate(list(pool.map(lambda _: take(counter, 20_000), range(4))))
    assert counter[0] == 80_000
    assert np.array_equal(np.sort(taken), np.arange(80_000))


def test_waits_until_the_number_is_reached():
    counter = np.zeros(1, np.int64)
    with ThreadPoolExecutor(2) as pool:
        waiting = pool.submit(wait_for, counter.ctypes.data, 50_000)
        take(counter, 49_999)
        assert not waiting.done()
        take(counter, 1)
        waiting.result(timeout=60)

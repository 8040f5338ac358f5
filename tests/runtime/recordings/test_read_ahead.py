import threading

import numpy as np
import pytest

from runtime.errors import ScanError
from runtime.recordings.read_ahead import read_ahead
from runtime.recordings.recording import Scan


def scan(index):
    return Scan(f"{index}", np.zeros((0, 3), np.float32))


def threads():
    return [one for one in threading.enumerate() if one.name == "read-ahead"]


def test_all_in_order_and_in_another_thread():
    seen = []

    def scans():
        for index in range(50):
            seen.append(threading.current_thread())
            yield scan(index)

    assert [one.key for one in read_ahead(scans())] == [str(index) for index in range(50)]
    assert threading.main_thread() not in seen
    assert list(read_ahead(iter([]))) == []
    assert threads() == []


def test_at_most_two_are_ahead():
    begun = [0]

    def scans():
        for index in range(20):
            begun[0] = index + 1
            yield scan(index)

    for index, _ in enumerate(read_ahead(scans())):
        assert begun[0] <= index + 3


@pytest.mark.parametrize("error", [ScanError("broken"), KeyError("a mistake")])
def test_an_error_comes_in_the_place_of_its_scan(error):
    def scans():
        yield scan(0)
        yield scan(1)
        raise error

    ahead, seen = read_ahead(scans()), []
    with pytest.raises(type(error)):
        seen.extend(one.key for one in ahead)
    assert seen == ["0", "1"]
    assert next(ahead, None) is None
    assert threads() == []


@pytest.mark.parametrize("taken", [0, 1, 2])
def test_who_stops_early_ends_the_thread(taken):
    ahead = read_ahead(scan(index) for index in range(1000))
    for _ in range(taken):
        next(ahead)
    ahead.close()
    assert threads() == []

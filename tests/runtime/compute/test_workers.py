"""Workers: every item once, errors out, safe after a fork, in any number."""

import os
import threading
import time

import pytest

from runtime.compute.workers import Workers
from runtime.errors import SettingError


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 2, 17])
def test_each_once(threads, count):
    seen: list[int] = []
    Workers(threads).each(seen.append, count)
    assert sorted(seen) == list(range(count))


def test_ranges_cover():
    seen: list[tuple[int, int]] = []
    Workers(3).ranges(lambda start, stop: seen.append((start, stop)), 10, 4)
    assert sorted(seen) == [(0, 4), (4, 8), (8, 10)]


def test_two_threads_at_once():
    barrier = threading.Barrier(2, timeout=20)
    Workers(2).each(lambda i: barrier.wait(), 2)


@pytest.mark.parametrize("bad", [0, 3])
def test_first_error_comes_out(bad):
    done = []

    def task(i):
        if i == bad:
            raise KeyError(i)
        done.append(i)

    with pytest.raises(KeyError):
        Workers(2).each(task, 4)


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "2", None])
def test_bad_threads(threads):
    with pytest.raises(SettingError, match="threads"):
        Workers(threads)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_after_fork():
    workers = Workers(2)
    workers.each(lambda i: None, 4)
    child = os.fork()
    if child == 0:
        seen = []
        workers.each(seen.append, 4)
        os._exit(0 if sorted(seen) == [0, 1, 2, 3] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_close_and_use_again():
    workers = Workers(2)
    workers.each(lambda i: None, 4)
    workers.close()
    seen = []
    workers.each(seen.append, 4)
    assert len(seen) == 4


def test_without_new_threads_the_caller_does_it_all(monkeypatch):
    def refuse(self):
        raise RuntimeError("can't start new thread")

    workers, seen = Workers(3), []
    monkeypatch.setattr(threading.Thread, "start", refuse)
    workers.each(seen.append, 5)
    monkeypatch.undo()
    workers.each(seen.append, 3)
    assert seen[:5] == [0, 1, 2, 3, 4]
    assert sorted(seen[5:]) == [0, 1, 2]


def test_nothing_goes_on_after_an_interrupt():
    """The helper is in a task when the caller is interrupted: `each` waits for it, and it takes no other."""
    workers, started, done = Workers(2), threading.Event(), []
    caller = threading.get_ident()

    def task(i):
        if threading.get_ident() == caller:
            started.wait(20)
            raise KeyboardInterrupt
        started.set()
        time.sleep(0.2)
        done.append(i)

    with pytest.raises(KeyboardInterrupt):
        workers.each(task, 50)
    assert len(done) == 1
    time.sleep(0.3)
    assert len(done) == 1

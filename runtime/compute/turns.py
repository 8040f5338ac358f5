"""One call at a time, and none in the middle of which the program forks or ends.

A fork in the middle would leave the child a state that is half written, and a lock that nobody opens any more. At the
end of a program, a daemon thread in compiled code would be ended in there, which aborts the process.
"""

import atexit
import os
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager

from runtime.errors import SettingError

LONGEST = 30.0  # s that a fork, or the end of the program, waits for a call


class Turns:
    """Calls from several threads wait for each other. A call may be stopped in between by one of its own thread."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self._taken = False
        with _making:
            _all.add(self)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """A turn. Raises SettingError within another of the same thread, as from a handler of warnings."""
        with self.lock:
            if self._taken:
                raise SettingError("this was called from within a call of itself: do it after that one")
            self._taken = True
            try:
                yield
            finally:
                self._taken = False


_all: "weakref.WeakSet[Turns]" = weakref.WeakSet()
_making = threading.Lock()
_held: list[Turns] = []


def _hold() -> None:
    """Wait until nobody is in a call, and let nobody begin one."""
    _making.acquire()
    _held.extend(one for one in list(_all) if one.lock.acquire(timeout=LONGEST))


def _let_go() -> None:
    while _held:
        _held.pop().lock.release()
    _making.release()


def _end() -> None:
    with _making:
        turns = list(_all)
    for one in turns:
        one.lock.acquire(timeout=LONGEST)  # for good


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_hold, after_in_parent=_let_go, after_in_child=_let_go)
atexit.register(_end)

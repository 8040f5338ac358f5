"""Only the newest counts: whoever is slow skips what came meanwhile, and never lags."""

from threading import Condition
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """What one thread puts and another takes. What was replaced before it was taken is dropped, and counted."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._waiting: list[T] = []
        self.came = self.dropped = 0

    def put(self, item: T) -> None:
        with self._changed:
            self.came += 1
            self.dropped += len(self._waiting)
            self._waiting = [item]
            self._changed.notify()

    def take(self, seconds: float) -> T | None:
        """The newest; None if nothing comes for so long."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._waiting), seconds)
            return self._waiting.pop() if self._waiting else None

    def restart(self) -> int:
        """Count anew; how many were dropped up to now, with what is waiting."""
        with self._changed:
            before = self.dropped + len(self._waiting)
            self.dropped, self._waiting = 0, []
            return before

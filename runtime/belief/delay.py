"""Results that wait for the evidence of later scans."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from runtime.belief.places import Places
from runtime.head.refiners import PointLabels

Result = TypeVar("Result")


@dataclass
class _Waiting(Generic[Result]):
    """A result, and what it will be made of; None: it is final."""

    index: int
    result: Result
    places: Places | None


class Delay(Generic[Result]):
    """A line of results, each of which is made final and due so many scans after its own."""

    def __init__(
        self,
        scans: int,
        judge: Callable[[Places], PointLabels],
        finish: Callable[[Result, PointLabels], Result],
    ) -> None:
        """judge: the labels of places by all that is known now; finish: a result with its final labels."""
        self._scans, self._judge, self._finish = scans, judge, finish
        self._line: deque[_Waiting[Result]] = deque()

    def put(self, index: int, result: Result, places: Places | None) -> None:
        """The result of scan `index`, the newest."""
        self._line.append(_Waiting(index, result, places.copy() if places and self._scans else None))

    def reach(self, index: int) -> None:
        """Scan `index` has been added to what is known: make final what waited for it."""
        for waiting in self._line:
            if waiting.index <= index - self._scans:
                self._settle(waiting)

    def due(self, index: int) -> Result | None:
        """The oldest result, if scan `index` is late enough for it."""
        late = bool(self._line) and self._line[0].index <= index - self._scans
        return self._line.popleft().result if late else None

    def settle(self) -> None:
        """Nothing more will be known: make all final."""
        for waiting in self._line:
            self._settle(waiting)

    def flush(self) -> list[Result]:
        """All results, oldest first, made final."""
        self.settle()
        found = [waiting.result for waiting in self._line]
        self._line.clear()
        return found

    def clear(self) -> None:
        """Drop all results."""
        self._line.clear()

    def _settle(self, waiting: _Waiting[Result]) -> None:
        if waiting.places is not None:
            waiting.result = self._finish(waiting.result, self._judge(waiting.places))
            waiting.places = None

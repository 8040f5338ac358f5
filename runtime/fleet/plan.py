"""What is to be done next: recordings, pieces of long ones, and what comes after the pieces."""

from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

from runtime.fleet.events import Divided, Done, Event, Hear, Said, Scans
from runtime.fleet.remote import Place, name_of
from runtime.fleet.work import Work


class Step(StrEnum):
    """Of a recording."""

    BEGIN = "begin"  # label it, or settle what holds for all pieces of it
    PIECE = "piece"  # label some of its scans
    END = "end"  # all pieces are done: write what is made of all of them


@dataclass(frozen=True)
class Task:
    """What one process does at a time."""

    place: Place
    step: Step = Step.BEGIN
    piece: range = range(0)  # numbers of scans
    error: str = ""  # at the end: what was wrong with a piece
    again: int = 0  # times that it was tried before
    source: str = ""  # where the recording is from, where that is not its place

    @property
    def name(self) -> str:
        """Of the recording."""
        return name_of(self.place)

    def once_more(self) -> "Task":
        return replace(self, again=self.again + 1)


class Way(Protocol):
    """How the recordings at some places are labelled: one after the other, in processes, on other machines."""

    def __call__(self, work: Work, places: Sequence[Place], *, hear: Hear) -> None:
        """`hear` is told of each recording, `Done` last. Raises what stops all of them."""


class Plan:
    """Gives the tasks, and tells of recordings what it is told of tasks."""

    def __init__(self, work: Work, places: Iterable[Place], hear: Hear) -> None:
        self._waiting, self._hear, self._length = deque(map(Task, places)), hear, work.piece
        self._pieces: dict[Place, _Pieces] = {}
        self._said: defaultdict[Place, set[Said]] = defaultdict(set)

    def next(self) -> Task | None:
        """The next task, unless none is known now."""
        return self._waiting.popleft() if self._waiting else None

    @property
    def waits(self) -> bool:
        """Whether a task is known."""
        return bool(self._waiting)

    def first(self, task: Task) -> None:
        """Let this task be the next one."""
        self._waiting.appendleft(task)

    def hear(self, task: Task, event: Event) -> None:
        """What is heard of a task. Each of them says `Done` or `Divided` last."""
        pieces, place = self._pieces.get(task.place), task.place
        if isinstance(event, Said):
            if pieces is None or event not in self._said[place]:  # each piece says the same
                self._hear(event)
            self._said[place].add(event)
        elif isinstance(event, Divided):
            assert self._length
            ranges = [range(at, min(at + self._length, event.scans)) for at in range(0, event.scans, self._length)]
            self._pieces[place] = _Pieces(event, set(ranges))
            self._waiting.extendleft(Task(place, Step.PIECE, one) for one in reversed(ranges))
        elif pieces is None:
            self._hear(event)
        elif isinstance(event, Scans):
            pieces.scans[task.piece] = event.done
            self._hear(Scans(event.name, pieces.scans.total(), pieces.begun.scans))
        else:
            pieces.done[task.piece] = event
            pieces.left.discard(task.piece)
            if task.step == Step.END:
                self._hear(pieces.together(event, sum(one.warning for one in self._said[place])))
                del self._pieces[place], self._said[place]
                return
            pieces.scans[task.piece] = event.scans + event.resumed
            self._hear(Scans(event.name, pieces.scans.total(), pieces.begun.scans))
            if not pieces.left:
                self.first(Task(place, Step.END, error=pieces.error()))


@dataclass
class _Pieces:
    """What is known of a recording in pieces."""

    begun: Divided
    left: set[range]
    scans: Counter[range] = field(default_factory=Counter)  # that are done, by piece
    done: dict[range, Done] = field(default_factory=dict)

    def error(self) -> str:
        """Of the first piece that has one."""
        errors = [self.done[piece].error for piece in sorted(self.done, key=lambda one: one.start)]
        return next((one for one in errors if one), "")

    def together(self, end: Done, warnings: int) -> Done:
        """Of all pieces, as of one recording."""
        done = list(self.done.values())
        hosts = {self.begun.host, *(one.host for one in done)} - {""}
        return Done(
            end.name,
            end.error,
            scans=sum(one.scans for one in done),
            resumed=sum(one.resumed for one in done),
            points=sum(one.points for one in done),
            moving=sum(one.moving for one in done),
            warnings=warnings,
            seconds=self.begun.seconds + sum(one.seconds for one in done),
            host=", ".join(sorted(hosts)),
        )

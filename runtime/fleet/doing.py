"""A task, done by the process that has a runner."""

import socket
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from runtime.errors import MosError, is_interrupt
from runtime.fleet import dividing
from runtime.fleet.at_hand import at_hand
from runtime.fleet.events import Divided, Done, Hear, Said, Scans
from runtime.fleet.labelling import label
from runtime.fleet.plan import Step, Task
from runtime.fleet.voice import Progress, heard
from runtime.fleet.work import Work
from runtime.predict import Summary
from runtime.runner import MosRunner


def do(work: Work, runner: MosRunner, task: Task, hear: Hear) -> Done | Divided:
    """Do a task. What is wrong with a recording is in the answer: it stops no other."""
    begun, voice = time.perf_counter(), Telling(task.name, hear)
    done: Done | Divided
    try:
        with heard(voice), at_hand(work, task) as (work, task, voice.worded):
            found = _DO[task.step](work, runner, task, voice)
        if isinstance(found, int):
            done = Divided(voice.name, found)
        else:
            done = Done(voice.name, task.error, found.scans, found.resumed, found.points, found.moving)
    except Exception as error:
        if is_interrupt(error):
            raise
        expected = isinstance(error, MosError | OSError)
        done = Done(voice.name, voice.worded(str(error) if expected else traceback.format_exc().rstrip()))
    if isinstance(done, Done):
        done = replace(done, warnings=voice.warnings)
    return replace(done, seconds=time.perf_counter() - begun, host=socket.gethostname())


def _begin(work: Work, runner: MosRunner, task: Task, voice: "Telling") -> Summary | int:
    """The number of scans, where they are to be labelled in pieces."""
    recording = dividing.opened(task, work.options)
    if work.piece and len(recording) > work.piece:
        dividing.begin(recording, runner, work, voice)
        return len(recording)
    return label(recording, runner, work.options, work.folder, work.overwrite, work.wanted, voice)


_DO = {Step.BEGIN: _begin, Step.PIECE: dividing.label_piece, Step.END: dividing.end}


class Telling:
    """The `Voice` of a recording among others."""

    def __init__(self, name: str, hear: Hear) -> None:
        self.name, self.warnings, self._hear = name, 0, hear
        self.worded: Callable[[str], str] = str  # what is said instead of a text

    def say(self, text: str) -> None:
        self._hear(Said(self.name, self.worded(text)))

    def warn(self, text: str) -> None:
        self.warnings += 1
        self._hear(Said(self.name, self.worded(text), warning=True))

    show = say

    @contextmanager
    def counted(self, what: str, labels: bool = False) -> Iterator[Progress]:
        def progress(done: int, total: int | None) -> None:
            if labels:
                self._hear(Scans(self.name, done, total))

        yield progress

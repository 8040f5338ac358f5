"""The progress bar of `mos run`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

if TYPE_CHECKING:
    from runtime.predict import Summary
    from runtime.recordings.sequence import Sequence
    from runtime.runner import MosRunner


class _Speed(ProgressColumn):
    """Scans per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f"{speed:.1f} scans/s" if speed else "- scans/s")


@contextmanager
def counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar for `progress(done, total)`."""
    columns = TextColumn(what), BarColumn(), MofNCompleteColumn(), _Speed(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


@contextmanager
def stages() -> Iterator[Callable[[str, int, int, str], None]]:
    """A bar for each stage of `report(stage, done, total, kernel)`, saying which kernel is being compiled."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    note = TextColumn("[dim]{task.fields[note]}")
    with Progress(*columns, note, console=Console(stderr=True)) as progress:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, done: int, total: int, kernel: str) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, note="")
            note = f"compiling {kernel}, once on this machine" if kernel else ""
            progress.update(tasks[stage], completed=done, total=total, note=note)

        yield show


def predict_with_progress(sequence: "Sequence", runner: "MosRunner", out: Path, overwrite: bool) -> "Summary":
    """`predict` with a bar: scans done, scans per second, time left."""
    from runtime.predict import predict  # with all that computes, which `mos eval` does without

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Speed(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(f"sequence {sequence.name}", total=len(sequence))
        started = False

        def show(done: int, total: int) -> None:
            nonlocal started
            if started:
                progress.update(task, completed=done)
            else:  # scans that were done before say nothing about the speed
                progress.reset(task, total=total, completed=done)
            started = True

        return predict(sequence, runner, out, overwrite=overwrite, on_progress=show)

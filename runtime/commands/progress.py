"""Progress bars, on stderr."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

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

from runtime.commands.output import Terminal


class _Speed(ProgressColumn):
    """Scans per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f"{speed:.1f} scans/s" if speed else "- scans/s")


@contextmanager
def counted(what: str) -> Iterator[Callable[[int, int | None], None]]:
    """A bar for `progress(done, total)`; total: None if it is not known."""
    name = TextColumn("{task.description}", markup=False)
    columns = name, BarColumn(), MofNCompleteColumn(), _Speed(), TimeRemainingColumn()
    with Progress(*columns, console=Terminal(stderr=True)) as progress:
        task = progress.add_task(what, total=None)
        started = False

        def show(done: int, total: int | None) -> None:
            nonlocal started
            if started:
                progress.update(task, completed=done, total=total)
            else:  # what was done before says nothing about the speed
                progress.reset(task, completed=done, total=total)
            started = True

        yield show


@contextmanager
def stages() -> Iterator[Callable[[str, int, int, str], None]]:
    """A bar for each stage of `report(stage, done, total, kernel)`, saying which kernel is being compiled."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    note = TextColumn("[dim]{task.fields[note]}")
    with Progress(*columns, note, console=Terminal(stderr=True)) as progress:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, done: int, total: int, kernel: str) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, note="")
            note = f"compiling {kernel}, once on this machine" if kernel else ""
            progress.update(tasks[stage], completed=done, total=total, note=note)

        yield show

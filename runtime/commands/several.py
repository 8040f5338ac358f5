"""Several recordings: progress over all of them, and a table at the end."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from runtime.commands.output import Terminal, say, show_line
from runtime.errors import some

if TYPE_CHECKING:
    from runtime.fleet.events import Done, Event
    from runtime.fleet.plan import Way
    from runtime.fleet.remote import Place
    from runtime.fleet.work import Work


def label_several(places: "Sequence[Place]", work: "Work", way: "Way") -> None:
    """Label the recordings at these places by one of the ways of `runtime.fleet`. Ends with 1 where one is not."""
    with _Watched(len(places)) as watched:
        way(work, places, hear=watched.hear)
    show_table(watched.done)
    show_line(f"predictions: {work.out}")
    if broken := [f"{one.name} ({one.error})" for one in watched.done if one.error]:
        say(f"{len(broken)} of {len(places)} recordings are not labelled, or not to their end: {some(broken)}")
        raise typer.Exit(1)


def show_table(done: "Sequence[Done]") -> None:
    """A line a recording, by name."""
    from runtime.doctor.findings import percent

    table = Table(box=None, pad_edge=False)
    table.add_column("recording", overflow="fold")
    for column in ("scans", "there already", "moving", "warnings", "seconds"):
        table.add_column(column, justify="right")
    table.add_column("host")
    for one in sorted(done, key=lambda one: one.name):
        counts = ("failed", "", "") if one.error else (str(one.scans + one.resumed), str(one.resumed), "-")
        if one.points:
            counts = (*counts[:2], percent(one.moving / one.points))
        cells = (one.name, *counts, str(one.warnings), f"{one.seconds:.1f}", one.host)
        table.add_row(*cells, style="red" if one.error else "")
    Terminal().print(table)


class _Watched:
    """What is heard of all recordings: lines on stderr, and a bar."""

    def __init__(self, count: int) -> None:
        self.done: list[Done] = []
        self._scans: dict[str, tuple[int, float]] = {}  # of each recording that runs or ran: scans, and the share done
        columns = TextColumn("recordings"), BarColumn(), TextColumn("{task.fields[text]}")
        self._bar = Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=Terminal(stderr=True))
        self._task, self._count = self._bar.add_task("", total=count, text=f"0/{count}"), count

    def __enter__(self) -> "_Watched":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def hear(self, event: "Event") -> None:
        """See `Hear`."""
        from runtime.fleet.events import Done, Said, Scans

        if isinstance(event, Said):
            name = f"{event.name}: " if event.name else ""
            say(f"{'warning: ' if event.warning else ''}{name}{event.text}")
            return
        if isinstance(event, Done):
            self.done.append(event)
            self._scans[event.name] = (event.scans + event.resumed, 1.0)
            if event.error:
                say(f"{event.name}: {event.error}")
        elif isinstance(event, Scans):
            self._scans[event.name] = (event.done, event.done / event.total if event.total else 0.0)
        scans, shares = (sum(numbers) for numbers in zip(*self._scans.values(), strict=True))
        text = f"{len(self.done)}/{self._count}, {scans:,} scans"
        self._bar.update(self._task, completed=shares, text=text)

"""What `mos run` and `mos clean` say at the end of a recording, or when they are interrupted."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer
from rich.table import Table

from runtime.commands.output import Terminal, say, show_line
from runtime.errors import is_interrupt

if TYPE_CHECKING:
    from runtime.predict import Summary


@contextmanager
def interruptible() -> Iterator[None]:
    """Within, an interrupt is said, and ends the command with 130."""
    try:
        yield
    except BaseException as error:
        if not is_interrupt(error):
            raise
        say("interrupted. Finished predictions are kept; the same command goes on from there")
        raise typer.Exit(130) from None


def show_summary(name: str, summary: "Summary") -> None:
    """What was done, how long a scan took, and where the predictions are."""
    import numpy as np

    from runtime.doctor.findings import percent

    already = f", {summary.resumed} were there already" if summary.resumed else ""
    anew = f", {summary.anew} of them anew: they, or scans that their labels depend on, have changed"
    show_line(f"sequence {name}: {summary.scans} scans{already}{anew if summary.anew else ''}")
    if summary.scans:
        share = percent(summary.moving / max(1, summary.points))
        show_line(f"{summary.points:,} points, {share} moving")
        table = Table("ms a scan", box=None, pad_edge=False)
        for column in ("median", "p95"):
            table.add_column(column, justify="right")
        for stage, seconds in summary.latency.items():
            median, p95 = np.percentile(1000 * np.asarray(seconds), [50, 95])
            table.add_row(stage, f"{median:.1f}", f"{p95:.1f}", style="bold" if stage == "scan" else "")
        Terminal().print(table)
    show_line(f"predictions: {summary.folder}")

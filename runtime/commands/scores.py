"""What `mos eval` prints on stdout."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from runtime.commands.output import Terminal, show_line

if TYPE_CHECKING:
    from runtime.evaluation.submission import Submission

COLUMNS = ("IoU", "precision", "recall", "points", "moving")


def show_scores(report: Mapping[str, Any]) -> None:
    """Print what `runtime.evaluation.report.score` found."""
    table = Table(box=None, pad_edge=False)
    table.add_column("moving class, %")
    for column in COLUMNS:
        table.add_column(column, justify="right")
    sequences = report["sequences"]
    for name, scores in sequences.items():
        _row(table, f"sequence {name}", scores, bold=len(sequences) == 1)
    if len(sequences) > 1:
        _row(table, "together", report["together"], bold=True)
    if report["by_range"]:
        _heading(table, "by distance")
        for name, scores in report["by_range"].items():
            _row(table, name, scores)
    if report["by_class"]:
        _heading(table, "by class")
        for name, scores in report["by_class"].items():
            _row(table, f"{scores['label']} {name}", {**scores, "moving": scores["points"]})
    Terminal().print(table)
    frames = report["together"]["frames"]
    show_line(f"{frames} frames; points without a true label (0, 1) are left out")
    if report["by_range_missing"]:
        show_line(f"not by distance: {report['by_range_missing']}")
    if report["by_class"]:
        show_line(f"by class: {report['by_class_measure']}")
    for note in report["notes"]:
        show_line(note)


def show_packed(packed: "Submission", path: Path) -> None:
    """What the archive `path` holds and what was checked."""
    for name, files in packed.files.items():
        show_line(f"sequence {name}: {len(files)} scans")
    show_line(f"checked: known labels; {packed.checked}")
    show_line(f"packed: {path}")


def _heading(table: Table, text: str) -> None:
    table.add_row()
    table.add_row(text, style="bold")


def _row(table: Table, name: str, scores: Mapping[str, Any], bold: bool = False) -> None:
    shares = (_percent(scores[key]) if key in scores else "" for key in ("iou", "precision", "recall"))
    counts = (f"{scores[key]:,}" for key in ("points", "moving"))
    table.add_row(Text(name), *shares, *counts, style="bold" if bold else "")


def _percent(share: float | None) -> str:
    return "undefined" if share is None else f"{100 * share:.2f}"

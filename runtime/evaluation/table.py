"""What `mos eval` prints on stdout."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from runtime.evaluation.submission import Submission

COLUMNS = ("IoU", "precision", "recall", "points", "moving")


def show_scores(report: Mapping[str, Any]) -> None:
    """Print what `runtime.evaluation.report.score` found."""
    console = Console(highlight=False, markup=False)
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
    console.print(table)
    frames = report["together"]["frames"]
    console.print(f"{frames} frames; points without a true label (0, 1) are left out")
    if report["by_range_missing"]:
        console.print(f"not by distance: {report['by_range_missing']}", soft_wrap=True)
    if report["by_class"]:
        console.print(f"by class: {report['by_class_measure']}", soft_wrap=True)
    for note in report["notes"]:
        console.print(note, soft_wrap=True)


def show_packed(packed: "Submission", path: Path) -> None:
    """What the archive `path` holds and what was checked."""
    console = Console(highlight=False, markup=False)
    for name, files in packed.files.items():
        console.print(f"sequence {name}: {len(files)} scans")
    console.print(f"checked: known labels; {packed.checked}", soft_wrap=True)
    console.print(f"packed: {path}", soft_wrap=True)


def _heading(table: Table, text: str) -> None:
    table.add_row()
    table.add_row(text, style="bold")


def _row(table: Table, name: str, scores: Mapping[str, Any], bold: bool = False) -> None:
    shares = (_percent(scores[key]) if key in scores else "" for key in ("iou", "precision", "recall"))
    counts = (f"{scores[key]:,}" for key in ("points", "moving"))
    table.add_row(Text(name), *shares, *counts, style="bold" if bold else "")


def _percent(share: float | None) -> str:
    return "undefined" if share is None else f"{100 * share:.2f}"

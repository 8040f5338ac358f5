"""The scores of predictions as one mapping, the content of the JSON file and of the table."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from runtime import __version__
from runtime.classes import MOVERS, RANGE, STATIC
from runtime.errors import SequenceError, some
from runtime.evaluation.confusion import Confusion
from runtime.evaluation.evaluate import BINS, UNKNOWN, Counts, evaluate
from runtime.evaluation.layout import Frame, Frames
from runtime.files import write_whole

PROTOCOL = (
    "SemanticKITTI-MOS: one confusion matrix over all frames; points of true label 0 or 1 are left out; 251-259 are "
    "moving; what was not predicted counts as not moving; scores are of the moving class"
)
PER_CLASS = "recall only: a prediction says that a point moves, not as what, so no false alarm belongs to a class"


def score(paired: Frames, on_progress: Callable[[int, int], object] = lambda done, total: None) -> dict[str, Any]:
    """Scores of the predictions that `runtime.evaluation.layout.pair` found.

    Shares are within 0..1, None where they are undefined (0 / 0; IoU and recall where nothing moves).
    `on_progress(done, total)` is called after each frame. Raises SequenceError naming every file that cannot be
    read, is of the wrong length or does not hold labels, or where no point has a label to be compared with.
    """
    no_ranges = _why_no_ranges(paired.frames)
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        on_progress(done, len(paired.frames))

    counts = evaluate(paired.frames, no_ranges is None, count)
    together = sum(counts.values(), Counts())
    if not scores_of(together)["points"]:
        raise SequenceError(f"{paired.truth}: no point has a label other than 0 and 1, so nothing was scored")
    return {
        "version": __version__,
        "protocol": PROTOCOL,
        "predictions": str(paired.predictions),
        "truth": str(paired.truth),
        "together": scores_of(together),
        "sequences": {name: scores_of(one) for name, one in counts.items()},
        "by_range": _by_range(together) if no_ranges is None else None,
        "by_range_missing": no_ranges,
        "by_class": _by_class(together),
        "by_class_measure": PER_CLASS,
        "notes": [*paired.notes, *_remarks(counts)],
    }


def save_scores(path: Path, report: Mapping[str, Any]) -> None:
    """Write what `score` found as JSON; the file is whole or absent. Raises OutputError."""
    write_whole(path, (json.dumps(report, indent=2, allow_nan=False) + "\n").encode())


def scores_of(counts: Counts) -> dict[str, Any]:
    """Scores of the moving class with the counts that they come from."""
    return {"frames": counts.frames, **_scores(counts.total())}


def _scores(confusion: Confusion) -> dict[str, Any]:
    found, missed, false = confusion.movers
    moving = found + missed
    return {
        "points": int(confusion.matrix[STATIC:].sum()),
        "moving": moving,
        "found": found,
        "missed": missed,
        "false_alarms": false,
        "iou": confusion.iou if moving else None,
        "precision": confusion.precision if found + false else None,
        "recall": confusion.recall if moving else None,
    }


def _by_range(counts: Counts) -> dict[str, dict[str, Any]]:
    rows = {name: _scores(part) for name, part in counts.by_range().items()}
    if not rows[BINS[UNKNOWN]]["points"]:
        del rows[BINS[UNKNOWN]]
    return rows


def _by_class(counts: Counts) -> dict[str, dict[str, Any]]:
    rows: dict[str, dict[str, Any]] = {}
    for label, name in MOVERS.items():
        found, points = counts.recall_of(label)
        if points:
            rows[name] = {"label": label, "points": points, "found": found, "recall": found / points}
    return rows


def _why_no_ranges(frames: tuple[Frame, ...]) -> str | None:
    without = [frame for frame in frames if frame.scan is None]
    if not without:
        return None
    if len(without) == len(frames):
        return "no scans beside the labels"
    missing = some([f"{frame.sequence}/{frame.truth.stem}" for frame in without])
    return f"scans are missing beside the labels: {missing}"


def _remarks(counts: Mapping[str, Counts]) -> list[str]:
    """What the scores of some sequences, or all, come from."""
    scores = {name: scores_of(one) for name, one in counts.items()}
    still = [name for name, one in scores.items() if not one["moving"]]
    silent = [name for name, one in scores.items() if one["moving"] and not one["found"] + one["false_alarms"]]
    remarks = []
    if still:
        where = "the labels hold" if len(still) == len(counts) else f"in sequence {some(still)} the labels hold"
        remarks.append(f"{where} no moving point: IoU and recall are undefined there")
    if silent:
        where = "" if len(silent) == len(counts) else f" in sequence {some(silent)}"
        remarks.append(f"no labelled point is predicted as moving ({RANGE}){where}")
    return remarks

"""SemanticKITTI labels in files: a uint32 a point, what it is in the lower 16 bits, of which object in the upper ones.

Every label file is read here, and looked at: values of another type would pass as "nothing moves".
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.classes import LABELS, MOVING_LABEL, OUTLIER, STATIC_LABEL, label_ids
from runtime.errors import SequenceError
from runtime.files import read_ordinary, write_whole
from runtime.recordings.label_types import guess, other_size

Labels = npt.NDArray[np.uint32]

LABEL_BYTES = 4  # of one point, little-endian

_TRUE = np.zeros(1 << 16, np.bool_)
_TRUE[list(LABELS)] = True
_PREDICTED = _TRUE.copy()
_PREDICTED[OUTLIER] = False  # nobody predicts outliers


def read_truth(path: str | Path, points: int | None = None) -> Labels:
    """True labels of a scan, (N,) uint32 with the numbers of objects.

    Raises SequenceError where the file cannot be read, has not `points` labels, or does not hold labels of
    SemanticKITTI, saying what it seems to hold.
    """
    return _read(Path(path), points, _TRUE, "are these labels of SemanticKITTI?")


def read_prediction(path: str | Path, points: int | None = None) -> Labels:
    """Predicted labels, as `read_truth`; outliers, which only a truth can hold, are an error too."""
    advice = f"write {MOVING_LABEL} for moving and {STATIC_LABEL} for static points, as little-endian uint32"
    return _read(Path(path), points, _PREDICTED, advice)


def write_labels(path: str | Path, moving: npt.NDArray[np.bool_]) -> None:
    """Write 251 for moving points and 9 for all others; the file is whole or absent. Raises OutputError."""
    labels = np.where(moving, MOVING_LABEL, STATIC_LABEL).astype("<u4")
    write_whole(path, labels.tobytes(), sync=False)  # made again in a moment; the disk would take a tenth of a scan


def _read(path: Path, points: int | None, known: npt.NDArray[np.bool_], advice: str) -> Labels:
    try:
        data = read_ordinary(path)
    except OSError as error:
        raise SequenceError(f"{path}: labels cannot be read: {error.strerror}") from error
    if len(data) % LABEL_BYTES or points not in (None, len(data) // LABEL_BYTES):
        wanted = "a whole number of" if points is None else str(points)
        seen = f"{len(data)} bytes are not the {LABEL_BYTES}-byte labels of {wanted} points"
        size = len(data) / points if points else 0
        hint = f", but so many numbers of {8 * size:.0f} bits; {advice}" if size in (1, 2, 8) else ""
        raise SequenceError(f"{path}: {seen}{hint}")
    labels = np.frombuffer(data, "<u4").astype(np.uint32)
    wrong = _find_wrong(labels, known)
    kind = guess(data) if wrong else other_size(data) if points is None else None
    if wrong or kind:
        seems = f"seems to hold {kind}" if kind else ""
        raise SequenceError(f"{path}: {'; '.join(part for part in (wrong, seems, advice) if part)}")
    return labels


def _find_wrong(labels: Labels, known: npt.NDArray[np.bool_]) -> str | None:
    """Why these are no labels: some are unknown, or none is a label though there are values."""
    ids = label_ids(labels)
    unknown = ~known[ids]
    if unknown.any():
        values, counts = np.unique(ids[unknown], return_counts=True)
        most = ", ".join(str(value) for value in values[:3]) + (", ..." if len(values) > 3 else "")
        return f"unknown label{'s' if len(values) > 1 else ''} {most} on {counts.sum()} of {len(labels)} points"
    if labels.any() and (ids <= OUTLIER).all():
        return f"none of {len(labels)} points has a label other than 0 and 1"
    return None

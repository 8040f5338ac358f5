"""SemanticKITTI labels: one uint32 a point, its class in the lower 16 bits."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.classes import MOVING_LABEL, STATIC_LABEL
from runtime.errors import SequenceError
from runtime.files import write_whole

LABEL_BYTES = 4  # of one point


def read_labels(path: str | Path, points: int | None = None) -> npt.NDArray[np.uint32]:
    """Raw labels of a scan, (N,) uint32. Raises SequenceError if broken or not `points` many."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SequenceError(f"{path}: labels cannot be read: {error.strerror}") from error
    if len(data) % LABEL_BYTES or points not in (None, len(data) // LABEL_BYTES):
        wanted = "a whole number of" if points is None else str(points)
        raise SequenceError(f"{path}: {len(data)} bytes are not the {LABEL_BYTES}-byte labels of {wanted} points")
    return np.frombuffer(data, "<u4").astype(np.uint32)


def write_labels(path: str | Path, moving: npt.NDArray[np.bool_]) -> None:
    """Write 251 for moving points and 9 for all others; the file is whole or absent. Raises OutputError."""
    labels = np.where(moving, MOVING_LABEL, STATIC_LABEL).astype("<u4")
    write_whole(path, labels.tobytes(), sync=False)  # made again in a moment; the disk would take a tenth of a scan

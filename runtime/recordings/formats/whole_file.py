"""What formats of one scan a file have in common."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError
from runtime.files import read_ordinary


def read_bytes(path: Path) -> bytes:
    """All of a file. Raises ScanError."""
    try:
        return read_ordinary(path)
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror}") from error


def numbers_in(text: str, width: int, path: Path) -> npt.NDArray[np.float64]:
    """The numbers of a text, `width` a row; what is left over of the last row is dropped. Raises ScanError."""
    try:
        values = np.array(text.split(), np.float64)
    except ValueError as error:
        raise ScanError(f"{path}: its points are not made of numbers: {error}") from error
    return values[: len(values) // width * width].reshape(-1, width)


def lines_of_points(body: bytes, points: int, width: int | None, path: Path) -> npt.NDArray[np.object_]:
    """The lines (N,) of a text that hold its points, with their ends.

    width: numbers a line; None: that differs. Raises ScanError where points are not a line each.
    """
    lines = [line for line in body.splitlines(keepends=True) if line.strip()][:points]
    if len(lines) != points or (width is not None and any(len(line.split()) != width for line in lines)):
        raise ScanError(f"{path}: its {points} points are not a line each, and cannot be left out one by one")
    return np.array(lines, object)

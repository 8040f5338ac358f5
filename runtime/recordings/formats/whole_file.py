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

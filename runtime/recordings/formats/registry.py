"""Every format of a file that holds one scan. A new one is a file like `ply.py` and one line in `FORMATS`."""

from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError
from runtime.files import open_ordinary
from runtime.recordings.cloud import Cloud
from runtime.recordings.formats import feather, las, npy, pcd, ply, raw

HEAD = 16  # bytes by which a file tells what it is


class Format(Protocol):
    """What a format's file offers."""

    SUFFIXES: tuple[str, ...]  # of names that files of this format have, in lower case

    def holds(self, head: bytes) -> bool:
        """Whether a file that begins with these bytes is of this format."""
        ...

    def read(self, path: Path) -> Cloud:
        """Raises ScanError or MissingPackageError."""
        ...

    def count(self, path: Path) -> int:
        """Number of points, of which no more is read than needed. Raises as `read`."""
        ...

    def kept(self, path: Path, keep: npt.NDArray[np.bool_]) -> bytes:
        """The same file with only some of its points (N,), all else about them as it is. Raises as `read`."""
        ...


FORMATS: tuple[Format, ...] = (npy, pcd, ply, las, feather)
SUFFIXES = (*raw.SUFFIXES, *(suffix for one in FORMATS for suffix in one.SUFFIXES))  # upper case too


def read_cloud(path: Path, columns: int = raw.COLUMNS) -> Cloud:
    """The points in a file; its content tells the format, or else its name. columns: numbers a point of a .bin.

    Raises ScanError or MissingPackageError.
    """
    one = _format_of(path)
    return raw.read(path, columns) if one is None else one.read(path)


def count_points(path: Path, columns: int = raw.COLUMNS) -> int:
    """Number of points in a file. Raises ScanError or MissingPackageError."""
    one = _format_of(path)
    return raw.count(path, columns) if one is None else one.count(path)


def kept_points(path: Path, keep: npt.NDArray[np.bool_], columns: int = raw.COLUMNS) -> bytes:
    """The same file with only some of its points (N,). Raises ScanError or MissingPackageError."""
    one = _format_of(path)
    return raw.kept(path, keep, columns) if one is None else one.kept(path, keep)


def _format_of(path: Path) -> Format | None:
    """The format of a file; None: raw numbers. Raises ScanError."""
    try:
        with open_ordinary(path) as file:
            head = file.read(HEAD)
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror}") from error
    by_content = (one for one in FORMATS if one.holds(head))
    by_name = (one for one in FORMATS if path.name.lower().endswith(one.SUFFIXES))
    return next(by_content, None) or next(by_name, None)


def find_columns(paths: tuple[Path, ...]) -> int:
    """How many numbers a point raw files among these hold, by their content."""
    return max(
        (raw.find_columns(path) for path in paths if path.is_file() and not _format_of(path)), default=raw.COLUMNS
    )

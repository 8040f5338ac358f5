"""A NumPy array (N, 4) x y z remission, or (N, 3)."""

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError
from runtime.recordings.cloud import Cloud
from runtime.recordings.scans import as_scan, check_scan

SUFFIXES: tuple[str, ...] = (".npy",)


def holds(head: bytes) -> bool:
    """By NumPy's magic."""
    return head.startswith(b"\x93NUMPY")


def read(path: Path) -> Cloud:
    """Raises ScanError."""
    return Cloud(as_scan(_open(path), str(path)))


def count(path: Path) -> int:
    """By the head of the file. Raises ScanError."""
    array = _open(path, mapped=True)
    check_scan(array[:0], str(path))
    return len(array)


def kept(path: Path, keep: npt.NDArray[np.bool_]) -> bytes:
    """In the dtype of the file. Raises ScanError."""
    file = io.BytesIO()
    np.save(file, _open(path)[keep])
    return file.getvalue()


def _open(path: Path, mapped: bool = False) -> npt.NDArray[np.generic]:
    """The array in a file; mapped: without reading it."""
    try:
        array = np.load(path, allow_pickle=False, mmap_mode="r" if mapped else None)
    except Exception as error:  # NumPy raises almost anything over bytes that are damaged
        raise ScanError(f"{path}: cannot be read as a NumPy array: {error}") from error
    if not isinstance(array, np.ndarray):
        raise ScanError(f"{path}: holds several arrays; save one array (points, 4) with numpy.save")
    return array

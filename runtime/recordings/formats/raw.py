"""Raw little-endian float32, point after point: x y z remission (KITTI), or x y z remission ring (nuScenes)."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError
from runtime.recordings.cloud import Cloud, whole_numbers
from runtime.recordings.formats.whole_file import read_bytes

SUFFIXES: tuple[str, ...] = (".bin",)
COLUMNS = 4  # numbers a point, where nothing else is known
NAMES = ("x", "y", "z", "remission", "ring")
MAX_RINGS = 256
ENOUGH = 100  # points, from which on a column of whole numbers is no chance


def read(path: Path, columns: int = COLUMNS) -> Cloud:
    """Of `columns` numbers a point the first four, and the fifth if it is a ring. Raises ScanError."""
    count(path, columns)
    try:
        values = np.fromfile(path, "<f4").reshape(-1, columns)
    except (OSError, ValueError) as error:  # a disk that fails, a file that is being written
        raise ScanError(f"{path}: cannot be read: {error}") from error
    data = np.ascontiguousarray(values[:, :4], np.float32)
    return Cloud(data, whole_numbers(values[:, 4]) if columns > 4 else None)


def count(path: Path, columns: int = COLUMNS) -> int:
    """Number of points, by the size of the file. Raises ScanError."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror}") from error
    if size % (4 * columns):
        raise ScanError(
            f"{path}: {size} bytes are no whole number of points of {4 * columns} bytes "
            f"(float32 {' '.join(NAMES[:columns])}{' ...' if columns > len(NAMES) else ''}); the file is cut off or of "
            f"another format (`columns`)"
        )
    return size // (4 * columns)


def kept(path: Path, keep: npt.NDArray[np.bool_], columns: int = COLUMNS) -> bytes:
    """All numbers of some points (N,). Raises ScanError."""
    return bytes(np.frombuffer(read_bytes(path), "<f4").reshape(-1, columns)[keep].tobytes())


def find_columns(path: Path) -> int:
    """5 where the fifth number of every point is that of a laser, else COLUMNS."""
    try:
        values: npt.NDArray[np.float32] = np.fromfile(path, "<f4")
    except OSError:  # is said when it is read
        return COLUMNS
    if len(values) % 5 or len(values) < 5 * ENOUGH:
        return COLUMNS
    ring = values[4::5]
    if not (np.isfinite(ring).all() and (ring == np.floor(ring)).all()):
        return COLUMNS
    return 5 if ring.min() >= 0 and ring.max() < MAX_RINGS and ring.max() > ring.min() else COLUMNS

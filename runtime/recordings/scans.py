"""The points of a scan: (N, 4) float32 x y z in metres, LiDAR frame, and remission; (N, 3) where there is none."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError

SUFFIXES = (".bin", ".npy")  # KITTI's raw float32 x y z remission; a NumPy array (N, 4) or (N, 3). Upper case too
POINT_BYTES = 16  # of one point in a .bin file

ScanData = npt.NDArray[np.float32]  # (N, 4) or (N, 3)


def as_scan(array: npt.ArrayLike, where: str = "scan") -> ScanData:
    """`array`, see `check_scan`, as float32, C-contiguous; no copy where it is that already, so never write into it.

    NaN and infinite points stay; float64 beyond the range of float32 becomes infinite.
    """
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(check_scan(array, where), np.float32)


def check_scan(array: npt.ArrayLike, where: str = "scan") -> npt.NDArray[np.floating]:
    """`array`, if it is (N, 4) or (N, 3) of float32 or float64. Raises ScanError, beginning with `where`."""
    try:
        data = np.asarray(array)
    except ValueError as error:  # rows of different lengths
        raise ScanError(f"{where}: is no array of points: {error}") from error
    if data.dtype.type not in (np.float32, np.float64):
        raise ScanError(f"{where}: points must be float32 or float64, not {data.dtype}; convert them to float32 metres")
    if data.ndim != 2 or data.shape[1] not in (3, 4):
        raise ScanError(
            f"{where}: a scan has the shape (points, 4) for x y z remission, or (points, 3) without "
            f"remission, not {data.shape}"
        )
    return data


def read_scan(path: str | Path) -> ScanData:
    """The points in a .bin (float32 x y z remission) or .npy file, as `as_scan`. Raises ScanError."""
    path = Path(path)
    if path.suffix.lower() == ".npy":
        return as_scan(_open_npy(path), str(path))
    _check_size(path)
    try:
        return as_scan(np.fromfile(path, "<f4").reshape(-1, 4), str(path))
    except (OSError, ValueError) as error:  # a disk that fails, a file that is being written
        raise ScanError(f"{path}: cannot be read: {error}") from error


def count_points(path: str | Path) -> int:
    """Number of points in a scan file, of which only size or head are read. Raises ScanError naming it."""
    path = Path(path)
    if path.suffix.lower() != ".npy":
        return _check_size(path)
    array = _open_npy(path, mapped=True)
    check_scan(array[:0], str(path))
    return len(array)


def _check_size(path: Path) -> int:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror}") from error
    if size % POINT_BYTES:
        raise ScanError(
            f"{path}: {size} bytes are no whole number of points of {POINT_BYTES} bytes "
            f"(float32 x y z remission); the file is cut off or of another format"
        )
    return size // POINT_BYTES


def _open_npy(path: Path, mapped: bool = False) -> npt.NDArray[np.generic]:
    """The array in a file; mapped: without reading it."""
    try:
        array = np.load(path, allow_pickle=False, mmap_mode="r" if mapped else None)
    except (ValueError, EOFError, OSError) as error:
        raise ScanError(f"{path}: cannot be read as a NumPy array: {error}") from error
    if not isinstance(array, np.ndarray):
        raise ScanError(f"{path}: holds several arrays; save one array (points, 4) with numpy.save")
    return array

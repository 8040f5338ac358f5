"""The points of a scan: (N, 4) float32 x y z in metres, LiDAR frame, and remission; (N, 3) where there is none."""

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError

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


def moved(data: ScanData, transform: npt.NDArray[np.floating]) -> ScanData:
    """A scan (N, 3 or 4) with its points moved by (4, 4) T_target_source; remission stays."""
    points = data.copy()
    points[:, :3] = data[:, :3].astype(np.float64) @ transform[:3, :3].T + transform[:3, 3]
    return points

"""LAS and LAZ, the formats of surveyors (extra `points`)."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from runtime.compute.packages import LASPY, LAZRS, need_package
from runtime.errors import ScanError
from runtime.recordings.cloud import RING, TIME, Cloud, cloud_of

SUFFIXES: tuple[str, ...] = (".las", ".laz")


def holds(head: bytes) -> bool:
    """By the signature."""
    return head.startswith(b"LASF")


def read(path: Path) -> Cloud:
    """Raises ScanError, MissingPackageError."""
    las = _read(path)
    columns = {name: np.asarray(las[name]) for name in ("x", "y", "z")}
    if np.any(las.intensity):  # the field is always there, and 0 where there is none
        columns["intensity"] = np.asarray(las.intensity)
    columns |= {
        name: np.asarray(las[name]) for name in las.point_format.dimension_names if name.lower() in (*RING, *TIME)
    }
    return cloud_of(columns, str(path))


def count(path: Path) -> int:
    """By the header. Raises ScanError, MissingPackageError."""
    with _open(path) as file:
        return int(file.header.point_count)


def kept(path: Path, keep: npt.NDArray[np.bool_]) -> bytes:
    """With all its dimensions and records. Raises ScanError, MissingPackageError."""
    las = _read(path)
    las.points = las.points[keep]
    file = io.BytesIO()
    las.write(file, do_compress=path.suffix.lower() == ".laz")
    return file.getvalue()


def _read(path: Path) -> Any:
    with _open(path) as file:
        try:
            las = file.read()
        except Exception as error:  # of laspy or of what unpacks LAZ: there is no common base
            raise ScanError(f"{path}: cannot be read as LAS: {error}") from error
        if len(las.points) != file.header.point_count:
            raise ScanError(f"{path}: is cut off: it holds {len(las.points)} of its {file.header.point_count} points")
        return las


def _open(path: Path) -> Any:
    need_package(LASPY, f"{path}: LAS")
    if path.suffix.lower() == ".laz":
        need_package(LAZRS, f"{path}: LAZ")
    import laspy

    try:
        return laspy.open(path)
    except Exception as error:
        raise ScanError(f"{path}: cannot be read as LAS: {error}") from error

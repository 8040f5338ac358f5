"""LAS and LAZ, the formats of surveyors (extra `points`)."""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from runtime.compute.packages import LASPY, LAZRS, need_package
from runtime.errors import ScanError
from runtime.files import open_ordinary
from runtime.recordings.cloud import RING, TIME, Cloud, cloud_of

SUFFIXES: tuple[str, ...] = (".las", ".laz")
RECORD, LATE_RECORD = 54, 60  # bytes of the head of each variable length record (ASPRS, LAS 1.4)
COMPRESSED, LEAST_CHUNK = 0x80, 20  # a bit of the point format; bytes of a chunk, which begins with a whole point
SMALL, RATIO = 1 << 26, 100  # bytes that points may unpack to whatever their file has, and how many times its own
PANIC = "PanicException"  # what lazrs raises where it meets what it did not think of: no Exception


def holds(head: bytes) -> bool:
    """By the signature."""
    return head.startswith(b"LASF")


def read(path: Path) -> Cloud:
    """Raises ScanError, MissingPackageError."""
    las = _read(path)
    with _refused(path, "read"):
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
    las, file = _read(path), io.BytesIO()
    with _refused(path, "written again"):  # what its header says may be nothing that is written
        las.points = las.points[keep]
        las.write(file, do_compress=path.suffix.lower() == ".laz", laz_backend=_backend())
    return file.getvalue()


def _read(path: Path) -> Any:
    with _open(path) as file:
        with _refused(path, "read"):
            las = file.read()
        if len(las.points) != file.header.point_count:
            raise ScanError(f"{path}: is cut off: it holds {len(las.points)} of its {file.header.point_count} points")
        return las


def _open(path: Path) -> Any:
    need_package(LASPY, f"{path}: LAS")
    if path.suffix.lower() == ".laz":
        need_package(LAZRS, f"{path}: LAZ")
    import laspy

    with _refused(path, "read"):
        _check_counts(path)
        return laspy.open(path, laz_backend=_backend())


def _backend() -> Any:
    """What unpacks LAZ in this thread: panics of others end the process."""
    import laspy

    return laspy.LazBackend.Lazrs


@contextmanager
def _refused(path: Path, what: str) -> Iterator[None]:
    """Whatever laspy and lazrs raise, which has no common base, as ScanError; scales may be none."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            yield
    except BaseException as error:
        if not isinstance(error, Exception) and type(error).__name__ != PANIC:
            raise
        raise ScanError(f"{path}: cannot be {what} as LAS: {error or type(error).__name__}") from error


def _check_counts(path: Path) -> None:
    """What is read below makes room for all that a header speaks of: minutes and gigabytes, and lazrs even aborts.

    Raises OSError, ValueError.
    """
    with open_ordinary(path) as file:
        head, size = file.read(255), os.fstat(file.fileno()).st_size

        def number(at: int, count: int, where: bytes = head) -> int:
            return int.from_bytes(where[at : at + count], "little")

        least, points = RECORD * number(100, 4), number(105, 2) * number(107, 4)
        if number(25, 1) >= 4:  # the minor version, since which records may follow the points too
            least += LATE_RECORD * number(243, 4)
            points = number(105, 2) * number(247, 8)
        most = max(SMALL, size)  # where less is missing, that is said when it was read
        if number(104, 1) & COMPRESSED:
            most = max(SMALL, RATIO * size)
            file.seek(number(96, 4))
            if (table := number(0, 8, file.read(8))) >= size:  # -1, where it was not known yet: it stands at the end
                file.seek(-8, os.SEEK_END)
                table = number(0, 8, file.read())
            file.seek(min(table, size))
            least += LEAST_CHUNK * number(4, 4, file.read(8))
    if least > size or points > most:
        raise ValueError("its header speaks of more than it has bytes for")

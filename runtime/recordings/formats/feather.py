"""Feather, Apache Arrow's file of named columns, as Argoverse 2 keeps its sweeps (extra `argoverse`)."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from runtime.compute.packages import PYARROW, need_package
from runtime.errors import ScanError
from runtime.recordings.cloud import Cloud, cloud_of

SUFFIXES: tuple[str, ...] = (".feather",)


def holds(head: bytes) -> bool:
    """By the signatures of both versions."""
    return head.startswith((b"ARROW1", b"FEA1"))


def read(path: Path) -> Cloud:
    """Raises ScanError, MissingPackageError."""
    return cloud_of(read_columns(path), str(path))


def count(path: Path) -> int:
    """Raises ScanError, MissingPackageError."""
    return int(_table(path, memory_map=True).num_rows)


def kept(path: Path, keep: npt.NDArray[np.bool_]) -> bytes:
    """With all its columns. Raises ScanError, MissingPackageError."""
    table = _table(path)
    from pyarrow import feather

    file = io.BytesIO()
    feather.write_feather(table.filter(keep), file)
    return file.getvalue()


def read_columns(path: Path) -> dict[str, npt.NDArray[np.generic]]:
    """The columns of a file by their names. Raises ScanError, MissingPackageError."""
    table = _table(path)
    return {name: column.to_numpy() for name, column in zip(table.column_names, table.columns, strict=True)}


def _table(path: Path, **how: Any) -> Any:
    need_package(PYARROW, f"{path}: Feather")
    import pyarrow
    from pyarrow import feather

    try:
        return feather.read_table(path, **how)
    except (pyarrow.ArrowException, OSError) as error:
        raise ScanError(f"{path}: cannot be read as Feather: {error}") from error

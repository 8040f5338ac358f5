"""Points as files of named columns, in formats that every tool reads."""

import io
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

Columns = Mapping[str, npt.NDArray[np.generic]]  # (N,) each, by name

PLY_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i1": "char", "u2": "ushort", "i4": "int", "u4": "uint"}


def as_ply(columns: Columns) -> bytes:
    """Binary, little-endian."""
    rows = _rows(columns)
    properties = [f"property {PLY_NAMES[rows.dtype[name].str[1:]]} {name}" for name in columns]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *properties, "end_header", ""]
    return "\n".join(lines).encode() + rows.tobytes()


def as_pcd(columns: Columns) -> bytes:
    """Binary, of version 0.7."""
    rows = _rows(columns)
    types = [rows.dtype[name] for name in columns]
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(columns)}",
        f"SIZE {' '.join(str(one.itemsize) for one in types)}",
        f"TYPE {' '.join(one.kind.upper() for one in types)}",
        f"COUNT {' '.join('1' for _ in types)}",
        f"WIDTH {len(rows)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(rows)}",
        "DATA binary",
        "",
    ]
    return "\n".join(lines).encode() + rows.tobytes()


def as_npy(columns: Columns) -> bytes:
    """NumPy's, (N, columns) float32, in their order."""
    file = io.BytesIO()
    np.save(file, np.column_stack([np.asarray(column, np.float32) for column in columns.values()]))
    return file.getvalue()


WRITERS: dict[str, Callable[[Columns], bytes]] = {"ply": as_ply, "pcd": as_pcd, "npy": as_npy}


def _rows(columns: Columns) -> npt.NDArray[np.void]:
    """The columns as records, little-endian, without gaps."""
    dtypes = [(name, column.dtype.newbyteorder("<")) for name, column in columns.items()]
    rows = np.empty(len(next(iter(columns.values()))), dtypes)
    for name, column in columns.items():
        rows[name] = column
    return rows

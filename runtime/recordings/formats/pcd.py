"""PCD, the Point Cloud Library's format: ASCII, binary, and compressed by LZF (extra `points`).

https://pointclouds.org/documentation/tutorials/pcd_file_format.html
"""

from dataclasses import dataclass
from itertools import accumulate
from math import prod
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.compute.packages import LZF, need_package
from runtime.errors import ScanError
from runtime.files import open_ordinary
from runtime.recordings.cloud import Cloud, cloud_of
from runtime.recordings.formats.whole_file import lines_of_points, numbers_in, read_bytes

SUFFIXES: tuple[str, ...] = (".pcd",)
MAX_HEADER = 65536  # bytes
WIDEST = 65536  # numbers a point
PADDING = "_"
TYPES = {"I": "i", "U": "u", "F": "f"}


def holds(head: bytes) -> bool:
    """By the comment that most tools write, or the first line of the header."""
    return head.startswith((b"# .PCD", b"VERSION"))


def read(path: Path) -> Cloud:
    """Points of an organised cloud row by row, those without a return too. Raises ScanError, MissingPackageError."""
    content = read_bytes(path)
    header = Header.of(content[:MAX_HEADER], path)
    body = content[header.size :]
    if header.encoding == "ascii":
        rows = numbers_in(body.decode("ascii", "replace"), header.width, path)
        _check_count(len(rows), header, path)
        columns = {one.name: rows[: header.points, one.column] for one in header.fields}
    elif header.encoding == "binary":
        if len(body) < header.points * header.stride:
            _check_count(len(body) // header.stride, header, path)
        records = np.frombuffer(body, header.record(), header.points)
        columns = {one.name: records[one.name] for one in header.fields}
    else:
        body = _decompress(body, path) if header.points else b""
        if len(body) < header.points * header.stride:
            raise ScanError(f"{path}: its points, decompressed, are {len(body)} bytes, too few for {header.points}")
        columns = {
            one.name: np.frombuffer(body, one.dtype, header.points, one.offset * header.points) for one in header.fields
        }
    return cloud_of(columns, str(path))


def kept(path: Path, keep: npt.NDArray[np.bool_]) -> bytes:
    """In its own encoding, with all fields; an organised cloud becomes a row. Raises ScanError, MissingPackageError."""
    content = read_bytes(path)
    header = Header.of(content[:MAX_HEADER], path)
    body, count = content[header.size :], int(keep.sum())
    if header.encoding == "ascii":
        body = b"".join(lines_of_points(body, header.points, header.width, path)[keep])
    elif header.encoding == "binary":
        body = np.frombuffer(body, f"V{header.stride}", header.points)[keep].tobytes()
    else:
        body = _compress(_of_kept_fields(_decompress(body, path), header, keep)) if header.points else body
    new = {b"WIDTH": count, b"HEIGHT": 1, b"POINTS": count}
    head = [_with_number(line, new) for line in content[: header.size].splitlines(keepends=True)]
    return b"".join(head) + body


def count(path: Path) -> int:
    """By the header. Raises ScanError."""
    try:
        with open_ordinary(path) as file:
            return Header.of(file.read(MAX_HEADER), path).points
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror}") from error


@dataclass(frozen=True)
class Field:
    """A column of one number a point; a field of several, or of none, is only stepped over."""

    name: str
    dtype: np.dtype[np.generic]
    offset: int  # bytes, within a point
    column: int  # numbers before it, within a point


@dataclass(frozen=True)
class Header:
    """What stands before the points."""

    fields: tuple[Field, ...]
    points: int
    encoding: str  # ascii, binary, binary_compressed
    stride: int  # bytes a point
    width: int  # numbers a point
    size: int  # bytes of the header itself
    sizes: tuple[int, ...]  # bytes of each field, of all its numbers

    def record(self) -> np.dtype[np.void]:
        """The dtype of one point, with the gaps between its fields."""
        names, dtypes = [one.name for one in self.fields], [one.dtype for one in self.fields]
        offsets = [one.offset for one in self.fields]
        return np.dtype({"names": names, "formats": dtypes, "offsets": offsets, "itemsize": self.stride})

    @classmethod
    def of(cls, head: bytes, path: Path) -> "Header":
        """Raises ScanError, naming the path."""
        lines, size = {}, 0
        for line in head.splitlines(keepends=True):
            size += len(line)
            key, *values = line.decode("ascii", "replace").partition("#")[0].split() or [""]
            lines[key.upper()] = values
            if key.upper() == "DATA":
                break
        if missing := [key for key in ("FIELDS", "SIZE", "TYPE", "DATA") if not lines.get(key)]:
            raise ScanError(f"{path}: is no whole PCD file: its header has no {', '.join(missing)}")
        names, kinds = lines["FIELDS"], lines["TYPE"]
        try:
            sizes = [int(value) for value in lines["SIZE"]]
            counts = [int(value) for value in lines.get("COUNT") or ["1"] * len(names)]
            shape = [int(*lines[key]) for key in ("WIDTH", "HEIGHT") if key in lines]
            points = int(*lines["POINTS"]) if "POINTS" in lines else prod(shape)
            dtypes = [np.dtype(f"<{TYPES[kind.upper()]}{width}") for kind, width in zip(kinds, sizes, strict=True)]
            parts = list(zip(names, dtypes, counts, strict=True))
        except (LookupError, ValueError, TypeError) as error:
            raise ScanError(f"{path}: its header is no PCD header: {error}") from error
        encoding = lines["DATA"][0].lower()
        if (
            encoding not in ("ascii", "binary", "binary_compressed")
            or points < 0
            or min(counts) < 0
            or not 0 < sum(counts) <= WIDEST
        ):
            raise ScanError(f"{path}: its header is no PCD header: DATA {encoding}, {points} points, COUNT {counts}")
        columns = list(accumulate(counts, initial=0))
        fields = {
            name: Field(name, dtype, offset, column)
            for (name, dtype, times), offset, column in zip(parts, _offsets(parts), columns, strict=False)
            if times == 1
        }
        stride = sum(dtype.itemsize * times for _, dtype, times in parts)
        if any(one.offset + one.dtype.itemsize > stride for one in fields.values()):
            raise ScanError(f"{path}: its header is no PCD header: COUNT {counts} leaves no room for its fields")
        widths = tuple(dtype.itemsize * times for _, dtype, times in parts)
        return cls(tuple(fields.values()), points, encoding, stride, columns[-1], size, widths)


def _offsets(parts: list[tuple[str, np.dtype[np.generic], int]]) -> list[int]:
    """Where each field begins, bytes. parts: names, types, counts.

    Padding of 0 bytes comes of a writer that puts the gaps of a structure of C where they are not: what follows lies
    where C aligns it.
    """
    found, at, lost = [], 0, False
    for name, dtype, times in parts:
        lost |= times == 0
        if lost:
            at += -at % dtype.itemsize
        found.append(at)
        at += 0 if lost and name == PADDING else dtype.itemsize * times
    return found


def _check_count(found: int, header: Header, path: Path) -> None:
    if found < header.points:
        raise ScanError(f"{path}: is cut off: it holds {found} of its {header.points} points")


def _with_number(line: bytes, new: dict[bytes, int]) -> bytes:
    """A line of a header with another number, if there is one for its key."""
    key, *_ = line.split() or [b""]
    if key.upper() not in new:
        return line
    end = line[len(line.rstrip()) :]
    return b"%s %d%s" % (key, new[key.upper()], end)


def _of_kept_fields(body: bytes, header: Header, keep: npt.NDArray[np.bool_]) -> bytes:
    """Field after field, of some points."""
    parts, at = [], 0
    for size in header.sizes:
        column = np.frombuffer(body, f"V{size}", header.points, at) if size else np.empty(0, "V1")
        parts.append(column[keep].tobytes() if size else b"")
        at += size * header.points
    return b"".join(parts)


def _compress(body: bytes) -> bytes:
    """With the two sizes before it. Not every short body becomes shorter."""
    import lzf

    packed = lzf.compress(body, 2 * len(body) + 16) if body else b""
    return np.array([len(packed), len(body)], "<u4").tobytes() + packed


def _decompress(body: bytes, path: Path) -> bytes:
    """What follows the two sizes, by LZF; field after field."""
    need_package(LZF, f"{path}: PCD compressed by LZF")
    import lzf

    packed, full = (int(size) for size in np.frombuffer(body[:8].ljust(8, b"\0"), "<u4"))
    if len(body) < 8 + packed:
        raise ScanError(f"{path}: is cut off: it holds {max(0, len(body) - 8)} of {packed} bytes of points")
    try:
        points: bytes | None = lzf.decompress(body[8 : 8 + packed], full)
    except ValueError:
        points = None
    if points is None or len(points) != full:
        raise ScanError(f"{path}: its points cannot be decompressed; the file is damaged")
    return points

"""PLY, the polygon file format: ASCII, binary of both byte orders; of its elements the vertices."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError
from runtime.files import open_ordinary
from runtime.recordings.cloud import Cloud, cloud_of
from runtime.recordings.formats.whole_file import lines_of_points, numbers_in, read_bytes

SUFFIXES: tuple[str, ...] = (".ply",)
MAX_HEADER = 65536  # bytes
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "<"}
TYPES = {  # by both of their names
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
Columns = dict[str, npt.NDArray[np.generic]]


@dataclass(frozen=True)
class Property:
    """A number of each row of an element, or a list of them."""

    name: str
    dtype: np.dtype[np.generic]
    length: np.dtype[np.generic] | None = None  # of a list: the type of its length, which stands before it


@dataclass(frozen=True)
class Element:
    """Rows of one kind."""

    name: str
    rows: int
    properties: list[Property]

    @property
    def lists(self) -> bool:
        """Whether rows differ in length."""
        return any(one.length for one in self.properties)


def holds(head: bytes) -> bool:
    """By the first line."""
    return head.startswith((b"ply\n", b"ply\r"))


def read(path: Path) -> Cloud:
    """Raises ScanError."""
    content = read_bytes(path)
    encoding, elements, at = _header(content[:MAX_HEADER], path)
    if encoding == "ascii":
        lines = [line for line in content[at:].decode("ascii", "replace").splitlines() if line.strip()]
        before = _rows_before(elements)
        return cloud_of(_from_lines(lines[before:], _vertices(elements, path), path), str(path))
    _vertices(elements, path)
    for element in elements:
        columns, at = _from_bytes(content, at, element, path)
        if element.name == "vertex":
            return cloud_of(columns, str(path))
    return cloud_of({}, str(path))


def kept(path: Path, keep: npt.NDArray[np.bool_]) -> bytes:
    """In its own encoding, with all its properties. Raises ScanError, also where other elements have rows, as faces."""
    content = read_bytes(path)
    encoding, elements, at = _header(content[:MAX_HEADER], path)
    vertices = _vertices(elements, path)
    if others := [one.name for one in elements if one.rows and one is not vertices]:
        raise ScanError(f"{path}: has {', '.join(others)} beside its points, which cannot be left out one by one")
    if encoding == "ascii":
        width = None if vertices.lists else len(vertices.properties)
        body = b"".join(lines_of_points(content[at:], vertices.rows, width, path)[keep])
    elif vertices.lists:
        raise ScanError(f"{path}: its points hold lists, and cannot be left out one by one")
    else:
        size = sum(one.dtype.itemsize for one in vertices.properties)
        body = np.frombuffer(content, f"V{size}", vertices.rows, at)[keep].tobytes()
    head = re.sub(rb"(?m)^(element\s+vertex\s+)\d+", b"\\g<1>%d" % keep.sum(), content[:at])
    return head + body


def count(path: Path) -> int:
    """By the header. Raises ScanError."""
    try:
        with open_ordinary(path) as file:
            return _vertices(_header(file.read(MAX_HEADER), path)[1], path).rows
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror}") from error


def _header(head: bytes, path: Path) -> tuple[str, list[Element], int]:
    """Encoding, elements in their order, and where their rows begin. Raises ScanError."""
    encoding, elements, at = "", list[Element](), 0
    for line in head.splitlines(keepends=True):
        at += len(line)
        words = line.decode("ascii", "replace").split()
        try:
            match words:
                case ["format", encoding, *_]:
                    order = ORDERS[encoding]
                case ["element", name, rows] if rows.isdigit():
                    elements.append(Element(name, int(rows), []))
                case ["property", "list", length, kind, name] if _is_new(name, elements):
                    types = [np.dtype(order + TYPES[one]) for one in (kind, length)]
                    elements[-1].properties.append(Property(name, *types))
                case ["property", kind, name] if _is_new(name, elements):
                    elements[-1].properties.append(Property(name, np.dtype(order + TYPES[kind])))
                case ["end_header"] if encoding:
                    return encoding, elements, at
                case ["element" | "property", *_]:
                    raise ValueError
        except (LookupError, ValueError, UnboundLocalError) as error:
            raise ScanError(f"{path}: its header is no PLY header: {' '.join(words)}") from error
    raise ScanError(f"{path}: is no whole PLY file: its header does not end")


def _is_new(name: str, elements: list[Element]) -> bool:
    """Whether the last element has no such property yet. Raises IndexError where there is no element."""
    return name not in [one.name for one in elements[-1].properties]


def _vertices(elements: list[Element], path: Path) -> Element:
    for element in elements:
        if element.name == "vertex":
            return element
    there = ", ".join(one.name for one in elements) or "none"
    raise ScanError(f"{path}: has no element 'vertex'; its elements are {there}")


def _rows_before(elements: list[Element]) -> int:
    """Rows before those of the vertices."""
    names = [element.name for element in elements]
    return sum(element.rows for element in elements[: names.index("vertex") if "vertex" in names else 0])


def _from_lines(lines: list[str], element: Element, path: Path) -> Columns:
    """The columns of the element that begins with these lines, one a row. Raises ScanError."""
    _check(len(lines), element, path)
    lines = lines[: element.rows]
    if element.lists:
        lines = [" ".join(_without_lists(line.split(), element)) for line in lines]
    names = [one.name for one in element.properties if one.length is None]
    if not names:
        return {}
    values = numbers_in("\n".join(lines), 1, path)
    _check(len(values) // len(names), element, path)
    if len(values) > element.rows * len(names):
        raise ScanError(f"{path}: rows of its element '{element.name}' hold more than its {len(names)} properties")
    values = values.reshape(element.rows, len(names))
    return {name: values[:, index] for index, name in enumerate(names)}


def _without_lists(words: list[str], element: Element) -> list[str]:
    found, at = [], 0
    for one in element.properties:
        if one.length is None:
            found += words[at : at + 1]
            at += 1
        else:
            length = words[at] if at < len(words) else ""
            at += 1 + (int(length) if length.isdigit() else 0)
    return found


def _from_bytes(content: bytes, at: int, element: Element, path: Path) -> tuple[Columns, int]:
    """The columns of the element that begins at byte `at`, and where the next one begins. Raises ScanError."""
    if element.lists:
        return _from_ragged_bytes(content, at, element, path)
    record = np.dtype({"names": [p.name for p in element.properties], "formats": [p.dtype for p in element.properties]})
    if record.itemsize:
        _check((len(content) - at) // record.itemsize, element, path)
    rows = np.frombuffer(content, record, element.rows, at) if element.rows and record.itemsize else np.empty(0, record)
    return {one.name: rows[one.name] for one in element.properties}, at + rows.nbytes


def _from_ragged_bytes(content: bytes, at: int, element: Element, path: Path) -> tuple[Columns, int]:
    """The same where rows hold lists, of different lengths: value after value."""
    least = sum((one.length or one.dtype).itemsize for one in element.properties)  # bytes of a row
    _check((len(content) - at) // least, element, path)
    columns: Columns = {p.name: np.empty(element.rows, p.dtype) for p in element.properties if p.length is None}
    for row in range(element.rows):
        for one in element.properties:
            if len(content) < at + (one.length or one.dtype).itemsize:
                _check(row, element, path)
            if one.length is None:
                columns[one.name][row] = np.frombuffer(content, one.dtype, 1, at)[0]
                at += one.dtype.itemsize
            else:
                length = int(np.frombuffer(content, one.length, 1, at)[0])
                at += one.length.itemsize + max(0, length) * one.dtype.itemsize
    return columns, at


def _check(found: int, element: Element, path: Path) -> None:
    if found < element.rows:
        raise ScanError(f"{path}: is cut off: it holds {found} of {element.rows} rows of its element '{element.name}'")

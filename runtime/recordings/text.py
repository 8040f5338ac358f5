"""Text files of numbers, as many tools write them."""

import codecs
import re
from collections.abc import Iterator
from pathlib import Path

from runtime.errors import PoseError
from runtime.files import read_ordinary

LONGEST = 1 << 30  # bytes
COMMENT = re.compile(r"[#%].*")
SEPARATOR = re.compile(r"[\s,;]+")
FORTRAN = re.compile(r"(?<=[\d.])[dD](?=[-+]?\d)")  # 1.5D+03


def read_text(path: Path) -> str:
    """A text in UTF-8 or, with a byte order mark, UTF-16 (as PowerShell writes it). Raises PoseError."""
    try:
        data = read_ordinary(path, LONGEST)
    except OSError as error:
        raise PoseError(f"{path}: cannot be read: {error.strerror}") from error
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise PoseError(f"{path}: is not a text file") from error
    if "\0" in text:
        raise PoseError(f"{path}: is not a text file")
    return text


def lines_of(text: str) -> Iterator[tuple[int, list[str]]]:
    """Number, from 1, and fields of each line that has any; parted by space, commas or semicolons; # and % comment."""
    for number, line in enumerate(text.splitlines(), 1):
        if "#" in line or "%" in line:
            line = COMMENT.sub("", line)
        fields = [one for one in SEPARATOR.split(line) if one] if "," in line or ";" in line else line.split()
        if fields:
            yield number, fields


def to_numbers(fields: list[str]) -> list[float]:
    """Fields as numbers; exponents may be Fortran's. Raises ValueError."""
    try:
        return list(map(float, fields))
    except ValueError:
        return [float(FORTRAN.sub("e", field)) for field in fields]

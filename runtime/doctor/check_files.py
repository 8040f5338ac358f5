"""Are all scans there, whole and of about one size?"""

import re
from itertools import pairwise

import numpy as np

from runtime.doctor.findings import Finding
from runtime.errors import MosError, some
from runtime.recordings.recording import Indexed


def check_files(recording: Indexed) -> list[Finding]:
    """Numbering and sizes of all scans."""
    found = []
    keys = recording.keys
    numbers = [number for key in keys if (number := scan_number(key)) is not None]
    steps = np.diff(numbers)
    gaps = [f"{a} to {b}" for a, b in pairwise(numbers) if b - a > np.median(steps)]
    if gaps and len(numbers) == len(keys) and max(steps) < 1e6:
        found.append(Finding("warn", "scans", f"file names jump from {some(gaps)}: scans are missing there"))
    sizes: dict[str, int] = {}
    broken: dict[str, str] = {}
    for index, key in enumerate(keys):
        try:
            sizes[key] = recording.count(index)
        except MosError as error:
            broken[key] = str(error)
    if broken:
        first, *others = broken
        more = f" (and {len(others)} more: {some(others)})" if others else ""
        found.append(Finding("bad", "scans", f"{broken[first]}{more}"))
    usual = np.median(list(sizes.values())) if sizes else 0
    empty = [name for name, size in sizes.items() if size == 0]
    small = [name for name, size in sizes.items() if 0 < size < usual / 2]
    if empty:
        found.append(Finding("warn", "scans", f"{some(empty)}: no points; every residual image needs its scan"))
    if small:
        found.append(Finding("warn", "scans", f"{some(small)}: less than half the usual {usual:,.0f} points"))
    if not any(finding.level == "bad" for finding in found):
        found.append(Finding("ok", "scans", f"{len(keys)} scans of about {usual:,.0f} points"))
    return found


def scan_number(key: str) -> int | None:
    """The number in the name of a scan, None where there is none or several."""
    numbers = re.findall(r"\d+", key)
    return int(numbers[0]) if len(numbers) == 1 else None

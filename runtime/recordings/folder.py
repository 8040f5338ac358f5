"""A folder of scans, one a file, numbered in order of time, with `poses.txt`, `calib.txt`, `times.txt` among them."""

from pathlib import Path

from runtime.recordings.formats.registry import SUFFIXES
from runtime.recordings.recording import Options
from runtime.recordings.scan_files import ScanFiles, open_files, scan_files

TITLE = f"a folder of {', '.join(SUFFIXES)} scans"


def find(path: Path) -> list[Path]:
    """`path` itself, if it holds scans."""
    return [path] if path.is_dir() and scan_files(path) else []


def open_at(path: Path, options: Options) -> ScanFiles:
    """The scans in the folder `path`. Raises SequenceError, PoseError."""
    return open_files(path, path, options)

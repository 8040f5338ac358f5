"""One file of points: a recording of one scan, to look at. What moves shows in several."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from runtime.errors import MosWarning
from runtime.recordings.formats.registry import SUFFIXES
from runtime.recordings.pose_files import ScanPoses, read_file_poses
from runtime.recordings.recording import Options
from runtime.recordings.scan_files import ScanFiles, of_files, scan_files

TITLE = f"one scan ({', '.join(SUFFIXES)})"


def find(path: Path) -> list[Path]:
    """`path` itself, by its name."""
    return [path] if path.is_file() and path.name.lower().endswith(SUFFIXES) else []


def open_at(path: Path, options: Options) -> ScanFiles:
    """The scan, at the origin of the world. Raises PoseError of `options.poses`; warns (MosWarning) that it is one."""
    beside = len(scan_files(path.parent)) - 1
    warnings.warn(
        f"{path}: is one scan, and what moves shows only in several: give the folder of all of them"
        + (f" ({beside} more are beside it)" if beside else ""),
        MosWarning,
        stacklevel=2,
    )
    found = ScanPoses(np.eye(4)[None], {}, "one scan", dict)
    if options.poses:
        found = read_file_poses(path.parent, (path,), options, None)
    scan = of_files(path.parent, (path,), options, None if options.points_only else found, None)
    return replace(scan, name=path.stem, source=str(path))

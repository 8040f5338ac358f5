"""SemanticKITTI's layout: `root/sequences/NN` with `velodyne/*.bin`, `calib.txt`, `times.txt`, `poses.txt` (or
`root/poses/NN.txt`)."""

from pathlib import Path

from runtime.recordings.recording import Options
from runtime.recordings.scan_files import ScanFiles, open_files

TITLE = "sequences/NN/velodyne of SemanticKITTI"
SCANS = "velodyne"


def find(path: Path) -> list[Path]:
    """Sequence folders: `path`, or the one above it where it is `velodyne`, or those in it or in its `sequences`."""
    if not path.is_dir():
        return []
    if path.name == SCANS:
        return [path.parent]
    if (path / SCANS).is_dir():
        return [path]
    root = path / "sequences" if (path / "sequences").is_dir() else path
    return [folder for folder in sorted(root.iterdir()) if (folder / SCANS).is_dir()]


def open_at(path: Path, options: Options) -> ScanFiles:
    """The sequence in the folder `path`. Raises SequenceError, PoseError."""
    return open_files(path, path / SCANS, options)

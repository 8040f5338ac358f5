"""Where poses that an odometry found break off: the note beside their files says it, whoever reads them again."""

import hashlib
import logging
from dataclasses import dataclass, field, replace
from pathlib import Path

from runtime.errors import MosError, OutputError, some
from runtime.recordings.around import Around
from runtime.recordings.recording import Indexed, Options, Scan
from runtime.typed_json import build, read_json

NOTE, KITTI = "odometry.json", "poses.txt"

log = logging.getLogger("lidar_mos.recordings.odometry")


@dataclass(frozen=True)
class Note:
    """What the poses beside it are."""

    odometry: str  # its name
    scans: str  # digest of those that they are of
    poses: str  # digest of the file as KITTI has them
    lost: dict[str, str] = field(default_factory=dict)  # see `Scan.lost`, by the scan's key
    tum: str = ""  # digest of the file as TUM has them


def read_note(folder: Path) -> Note | None:
    """The note in a folder; None where there is none that can be read."""
    try:
        return build(Note, read_json(folder / NOTE, OutputError), str(folder / NOTE))
    except (MosError, OSError):  # none, cut off, or by another version
        return None


def digest_of(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def with_breaks(recording: Indexed, options: Options) -> Indexed:
    """The recording, with the breaks in its poses if their file is one that an odometry wrote; else itself."""
    path = options.poses or Path(recording.source) / KITTI
    if recording.poses is None or not path.is_file() or (note := read_note(path.parent)) is None or not note.lost:
        return recording
    if digest_of(path.read_bytes()) not in (note.poses, note.tum):
        log.info("%s: is not the file of which %s tells breaks: they do not count", path, path.with_name(NOTE))
        return recording
    lost = {index: note.lost[key] for index, key in enumerate(recording.keys) if key in note.lost}
    log.info("%s: %s was lost at %s", path, note.odometry, some([recording.keys[index] for index in lost]) or "no scan")
    return Broken(recording, lost)


class Broken(Around):
    """The recording, of which it is not known how some scans lie to those before them."""

    def __init__(self, within: Indexed, lost: dict[int, str]) -> None:
        """lost: see `Scan.lost`, by number."""
        super().__init__(within)
        self.lost = lost

    def seen(self, index: int, scan: Scan) -> Scan:
        return replace(scan, lost=self.lost.get(index, ""))

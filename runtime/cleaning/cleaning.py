"""From the votes on a recording to what is left of it: a static map, and its scans without movers."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.cleaning.votes import RecordingVotes
from runtime.errors import SettingError
from runtime.files import replacing_folder, write_whole
from runtime.odometry.located import Progress
from runtime.recordings.formats.writing import WRITERS, Columns
from runtime.recordings.recording import Scan

SAME = "same"  # the format of the recording itself
FORMATS = (SAME, *WRITERS)
MAPS = ("ply", "pcd")
CLEAN, MAP = "clean", "map"  # names of the folder of scans, and of the map


@dataclass
class Left:
    """What was written of scans."""

    folder: Path
    scans: int = 0
    points: int = 0  # of the recording
    kept: int = 0


def write_maps(votes: RecordingVotes, folder: Path, form: str = MAPS[0]) -> dict[Path, int]:
    """The static map of each stretch, in the frame of its first scan, and how many points it has.

    `map.ply`, or with several stretches `map_KEY.ply` by the first scan. Points are the means of what stands still in a
    voxel, with `intensity`, and `scans`: how many saw something there. form: of MAPS. Raises SettingError, OutputError.
    """
    _check(form, MAPS)
    written = {}
    for stretch in votes.stretches:
        name = MAP if len(votes.stretches) == 1 else f"{MAP}_{stretch.keys[0]}"
        path = folder / f"{name}.{form}"
        found = stretch.votes.static_map()
        columns = {**_places(found.points), "intensity": found.remission, "scans": found.scans}
        write_whole(path, WRITERS[form](columns))
        written[path] = len(found.points)
    return written


def write_clean(
    votes: RecordingVotes, folder: Path, form: str = SAME, on_progress: Progress = lambda done, total: None
) -> Left:
    """The recording without the points that move, in `folder`, which is whole or absent; one that was there goes.

    form: of FORMATS. `SAME`: that of the recording, its files or its bag as they are but for those points; else a file
    for each scan, of its points as the network got them. Raises SettingError, OutputError.
    """
    _check(form, FORMATS)
    left = Left(folder)
    with replacing_folder(folder) as new:
        if form == SAME:
            votes.recording.write_kept(new, ((index, keep) for index, _, keep in _counted(votes, left, on_progress)))
        else:
            for _, scan, keep in _counted(votes, left, on_progress):
                write_whole(new / f"{scan.key}.{form}", WRITERS[form](columns_of(scan, keep)), sync=False)
    return left


def columns_of(scan: Scan, keep: NDArray[np.bool_] | slice = slice(None)) -> dict[str, NDArray[np.generic]]:
    """x, y, z, and what there is of intensity, ring and time, of some points of a scan, or all."""
    columns: dict[str, NDArray[np.generic]] = dict(_places(scan.points[keep]))
    if scan.remission is not None:
        columns["intensity"] = scan.remission[keep]
    if scan.ring is not None:
        columns["ring"] = scan.ring[keep].astype(np.int32)
    if scan.times is not None:
        columns["time"] = scan.times[keep]
    return columns


def _counted(votes: RecordingVotes, left: Left, on_progress: Progress) -> Iterator[tuple[int, Scan, NDArray[np.bool_]]]:
    """All scans, while they are counted."""
    for index, scan, keep in votes.scans(on_progress):
        left.scans += 1
        left.points += len(keep)
        left.kept += int(np.count_nonzero(keep))
        yield index, scan, keep


def _places(points: NDArray[np.float32]) -> Columns:
    return {axis: points[:, index] for index, axis in enumerate("xyz")}


def _check(form: str, known: tuple[str, ...]) -> None:
    if form not in known:
        raise SettingError(f"`format` must be one of {', '.join(known)}, not {form!r}")

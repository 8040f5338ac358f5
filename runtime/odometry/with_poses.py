"""From a recording to one with poses, by odometry."""

import logging
import warnings
from pathlib import Path

from runtime.errors import MosWarning, some
from runtime.odometry.located import Located, Progress, find_poses
from runtime.odometry.odometry import KISS, Odometry, choose_odometry, name_of
from runtime.odometry.pose_store import check_place, read_poses, write_poses
from runtime.recordings.deskewed import deskewing
from runtime.recordings.recording import Indexed

log = logging.getLogger("lidar_mos.recordings.odometry")


def with_poses(
    recording: Indexed,
    odometry: str | Odometry = KISS,
    *,
    folder: Path | None = None,
    chosen: range | None = None,
    deskew: bool = True,
    trusted: bool = False,
    on_progress: Progress = lambda done, total: None,
) -> Indexed:
    """The recording itself if it has poses; else one whose poses are found, in one pass over all of its scans.

    folder: where the poses are kept, and taken from if they are there, of these scans and this odometry; None: nowhere.
    chosen: only these consecutive scans have poses; None: all. deskew: of points with times.
    trusted: the poses that are kept are of these scans, which are not read to see that.

    The logger says what was chosen; a MosWarning, where the odometry was lost. Raises SettingError, OutputError,
    MissingPackageError, and what the odometry raises.
    """
    if recording.poses is not None:
        return recording
    if folder and chosen is None:
        check_place(folder)
    finder = choose_odometry(odometry)
    name = name_of(finder)
    kept = folder is not None and chosen is None
    found = read_poses(folder, recording, name, deskew, on_progress, trusted) if folder and kept else None
    if found is not None:
        log.info("%s: no poses are given; those that %s found before are in %s", recording.source, name, folder)
    else:
        log.info("%s: no poses are given: they are found by %s", recording.source, name)
        found = find_poses(recording, finder, chosen, deskew, on_progress)
        if folder and chosen is None:
            write_poses(folder, found, recording)
    if found.lost:
        places = some([f"{recording.keys[index]} ({why})" for index, why in found.lost.items()])
        warnings.warn(
            f"{recording.source}: {name} does not know how {len(found.lost)} scans lie to those before them: {places}. "
            f"What was seen before does not count there",
            MosWarning,
            stacklevel=2,
        )
    located = Located(recording, found)
    return deskewing(located) if deskew else located

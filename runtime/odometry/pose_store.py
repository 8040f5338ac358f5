"""Poses that were found, in files beside the labels: for other tools, and for the next run."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from runtime.errors import MosError, OutputError
from runtime.files import write_whole
from runtime.odometry.located import Digest, FoundPoses, Progress, readable
from runtime.recordings.breaks import KITTI, NOTE, Note, digest_of, read_note
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.recording import Indexed
from runtime.recordings.rotations import quaternions_of_matrices

TUM, CALIB = "poses.tum", "calib.txt"
IDENTITY = "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n"  # with it, the LiDAR's own poses are those of KITTI's camera


def check_place(folder: Path) -> None:
    """Raises OutputError where files would be replaced that are not those of `write_poses`, as a recording's own."""
    there = [name for name in (KITTI, TUM, CALIB) if (folder / name).exists()]
    if there and not (folder / NOTE).is_file():
        raise OutputError(f"{folder}: holds {' and '.join(there)} that no odometry wrote; choose another place (`out`)")


def write_poses(folder: Path, found: FoundPoses, recording: Indexed) -> None:
    """T_world_lidar as KITTI has poses, and as TUM has them, to all their digits. Raises OutputError.

    A scan without a pose is NaN to KITTI, and left out for TUM. Where the times of scans are not known, TUM's are their
    numbers, from 0.
    """
    kitti = "".join(_line(pose[:3].ravel()) for pose in found.poses).encode()
    times = np.arange(len(found.poses)) if recording.times is None else recording.times
    known = np.isfinite(found.poses).all((1, 2))
    turns = quaternions_of_matrices(found.poses[known, :3, :3])
    rows = np.column_stack([times[known], found.poses[known, :3, 3], turns])
    tum = "".join(map(_line, rows)).encode()
    check_place(folder)
    _write_note(folder, Note(found.odometry, found.scans, ""))  # it must not speak of other poses
    write_whole(folder / KITTI, kitti)
    write_whole(folder / TUM, tum)
    write_whole(folder / CALIB, IDENTITY.encode())
    lost = {recording.keys[index]: why for index, why in found.lost.items()}
    _write_note(folder, Note(found.odometry, found.scans, digest_of(kitti), lost, digest_of(tum)))


def read_poses(
    folder: Path,
    recording: Indexed,
    odometry: str,
    deskew: bool,
    on_progress: Progress = lambda done, total: None,
    trusted: bool = False,
) -> FoundPoses | None:
    """What `write_poses` wrote, if it is of this odometry and of all scans of the recording as they are now.

    trusted: of the scans it is.
    """
    if (note := read_note(folder)) is None:
        return None
    try:
        poses = read_pose_table(folder / KITTI).poses
        same = note.poses == digest_of((folder / KITTI).read_bytes())
    except (MosError, OSError):  # cut off, or by another version: they are found anew
        return None
    if not same or note.odometry != odometry or len(poses) != len(recording):
        return None
    numbers = {key: index for index, key in enumerate(recording.keys)}
    lost = {numbers[key]: why for key, why in note.lost.items()}
    kept = FoundPoses(odometry, poses, lost, note.scans)
    if trusted:
        return kept
    digest = Digest(deskew)
    for _, scan in readable(recording, range(len(recording)), on_progress):
        digest.add(recording.fingerprint(scan))
    return kept if digest.text() == note.scans else None


def _write_note(folder: Path, note: Note) -> None:
    write_whole(folder / NOTE, (json.dumps(asdict(note), indent=2) + "\n").encode())


def _line(numbers: np.ndarray) -> str:
    return " ".join(repr(float(number)) for number in numbers) + "\n"

"""KITTI's calibration files: where the LiDAR sits, seen from the camera whose poses a recording has."""

import warnings
from pathlib import Path

import numpy as np

from runtime.errors import MosWarning, PoseError
from runtime.recordings.poses import Pose, check_pose
from runtime.recordings.text import lines_of, read_text, to_numbers

WHOLE = ("Tr",)  # odometry: from the LiDAR to the rectified camera
UNRECTIFIED = ("Tr_velo_to_cam", "Tr_velo_cam")  # object and tracking: to the camera before its rectification
RECTIFICATION = ("R0_rect", "R_rect", "R_rect_00", "R_rect_0")


def read_calib(path: str | Path) -> Pose:
    """T_camera_lidar (4, 4) of a KITTI calibration: `Tr` (odometry), or `R0_rect` times `Tr_velo_to_cam` (object,
    tracking, under all names that they have), or `R_rect_00` times `R` and `T` (raw data, both files in one).

    Raises PoseError if it is missing or not rigid. Warns (MosWarning) where the rectification is missing.
    """
    path = Path(path)
    found = _entries(path)
    if key := next((key for key in WHOLE if key in found), None):
        return _transform(path, key, found[key])
    if key := next((key for key in UNRECTIFIED if key in found), None):
        tr = _transform(path, key, found[key])
    elif "R" in found and "T" in found:
        key = "R and T"
        tr = _rotation(path, "R", found["R"])
        tr[:3, 3] = _numbers(path, "T", found["T"], 3)
    else:
        raise PoseError(f"{path}: has no line 'Tr:' with the transform from LiDAR to camera, nor 'Tr_velo_to_cam:'")
    if rectification := next((key for key in RECTIFICATION if key in found), None):
        rectified: Pose = _rotation(path, rectification, found[rectification]) @ tr
        return rectified
    warnings.warn(
        f"{path}: {key} without R0_rect: it leads to the camera before its rectification, about half a degree off "
        f"KITTI's poses, which costs accuracy; add the line 'R0_rect:' of the same calibration",
        MosWarning,
        stacklevel=2,
    )
    return tr


def _entries(path: Path) -> dict[str, list[str]]:
    """Fields by key; a colon after the key may be there or not."""
    found = {}
    for _, (key, *fields) in lines_of(read_text(path)):
        name, _, first = key.partition(":")
        found[name] = [field for field in (first, *fields) if field not in ("", ":")]
    return found


def _numbers(path: Path, key: str, fields: list[str], count: int) -> list[float]:
    try:
        values = to_numbers(fields)
    except ValueError as error:
        raise PoseError(f"{path}: {key} is not made of numbers") from error
    if len(values) != count:
        raise PoseError(f"{path}: {key} has {len(values)} numbers, not {count}")
    return values


def _transform(path: Path, key: str, fields: list[str]) -> Pose:
    values = np.reshape(_numbers(path, key, fields, 12), (3, 4))
    return check_pose(np.vstack([values, [0, 0, 0, 1]]), f"{path}: {key}")


def _rotation(path: Path, key: str, fields: list[str]) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(_numbers(path, key, fields, 9), (3, 3))
    return check_pose(matrix, f"{path}: {key}")

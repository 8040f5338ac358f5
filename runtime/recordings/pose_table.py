"""Pose files: KITTI's, TUM's, and tables with a header."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import PoseError
from runtime.recordings.poses import Poses
from runtime.recordings.rotations import matrices_of_quaternions
from runtime.recordings.text import lines_of, read_text, to_numbers

COLUMNS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")  # of TUM
UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}  # of time, in one second
EPOCH = 1e11  # s; later times are in milliseconds, and so on
NUMBER = re.compile(r"[-+]?\.?\d|[-+]?(nan|inf)", re.IGNORECASE)
TIME = re.compile(r"(time|stamp|timestamp|time_?stamp|t|secs?|seconds)(_(sec|secs|s|ms|us|ns))?")
PLACE = re.compile(r"(?:(?:t|p|pos|position|translation)_?)?([xyz])(?:_m)?")
TURN = re.compile(r"(?:q|quat|quaternion|rot|rotation|o|orientation)_?([xyzw])")


@dataclass(frozen=True)
class PoseTable:
    """What a pose file holds."""

    poses: Poses  # (T, 4, 4) in the frame of the file, not yet checked by `check_pose`
    times: npt.NDArray[np.float64] | None  # (T,) s; None where the file has none


def read_pose_table(path: str | Path) -> PoseTable:
    """The poses of a text file. Lines as in `lines_of`.

    One pose a line: 12 numbers (KITTI, the upper three rows), 16 numbers (the whole matrix), or 8 numbers
    (TUM: time, position, quaternion x y z w). Or a table whose first line names its columns, of which position and
    quaternion must be there; a time may be. Raises PoseError naming the file and the line.
    """
    path = Path(path)
    rows: list[list[float]] = []
    header: list[str] = []
    for number, fields in lines_of(read_text(path)):
        try:
            row = to_numbers(fields)
        except ValueError as error:
            if not rows and not header and not any(NUMBER.match(field) for field in fields):
                header = fields
                continue
            raise PoseError(f"{path}: line {number} is not made of numbers") from error
        if header and len(row) != len(header):
            raise PoseError(f"{path}: line {number} has {len(row)} numbers for the {len(header)} columns of its header")
        if not header and (len(row) not in (8, 12, 16) or len(row) != len(rows[0] if rows else row)):
            expected = f"{len(rows[0])} like the lines before" if rows else "12 (KITTI), 16 (matrix) or 8 (TUM)"
            raise PoseError(f"{path}: line {number} has {len(row)} numbers, not {expected}")
        rows.append(row)
    if not rows:
        raise PoseError(f"{path}: holds no poses")
    values = np.array(rows)
    if header:
        return _of_columns(values, header, path)
    if values.shape[1] == 8:
        return PoseTable(from_quaternions(values[:, 1:4], values[:, 4:]), values[:, 0])
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, : values.shape[1] // 4] = values.reshape(len(values), -1, 4)
    return PoseTable(poses, None)


def from_quaternions(places: npt.NDArray[np.float64], quaternions: npt.NDArray[np.float64]) -> Poses:
    """Poses (T, 4, 4) of positions (T, 3) and quaternions (T, 4) x y z w of any length; one of zeros becomes NaN."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, 3] = places
    poses[:, :3, :3] = matrices_of_quaternions(quaternions)
    return poses


def _of_columns(values: npt.NDArray[np.float64], header: list[str], path: Path) -> PoseTable:
    """The table of named columns (T, C). Raises PoseError where one is missing, or there twice."""
    found: dict[str, int] = {}
    for index, name in enumerate(header):
        if (meaning := _meaning(name)) and found.setdefault(meaning, index) != index:
            raise PoseError(f"{path}: its header has two columns for {meaning}: {header[found[meaning]]} and {name}")
    if missing := [name for name in COLUMNS[1:] if name not in found]:
        raise PoseError(f"{path}: its header {' '.join(header)} has no column for {', '.join(missing)}")
    x, y, z, *quaternion = (values[:, found[name]] for name in COLUMNS[1:])
    times = None
    if "time" in found:
        unit = header[found["time"]].lower().rpartition("_")[2]
        times = values[:, found["time"]] / (UNITS[unit] if unit in UNITS else _unit(values[:, found["time"]]))
    return PoseTable(from_quaternions(np.stack([x, y, z], 1), np.stack(quaternion, 1)), times)


def _meaning(name: str) -> str | None:
    """What a column is, of COLUMNS, by its name."""
    last = ".".join(name.lower().strip("\"'").split(".")[-2:])  # of ROS's names, as pose.pose.orientation.x
    for plain in (last.replace(".", "_"), last.rpartition(".")[2]):
        if turn := TURN.fullmatch(plain):
            return f"q{turn[1]}"
        if place := PLACE.fullmatch(plain):
            return place[1]
        if TIME.fullmatch(plain):
            return "time"
    return None


def _unit(times: npt.NDArray[np.float64]) -> float:
    """Of times that are seconds since 1970, or since the start."""
    latest = float(np.nanmax(np.abs(times), initial=0))
    return next(unit for unit in UNITS.values() if latest / unit < EPOCH or unit == UNITS["ns"])

"""Where the LiDAR sits in the frame whose poses a recording has: the body, an IMU, a vehicle."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import PoseError, SettingError
from runtime.recordings.pose_table import from_quaternions
from runtime.recordings.poses import Pose, check_pose
from runtime.recordings.text import lines_of, read_text, to_numbers

HELP = "7 numbers (x y z in m, quaternion x y z w), 12 or 16 (the matrix row by row), or a file that holds them"


def read_extrinsics(given: str | Path) -> Pose:
    """T_body_lidar (4, 4) of numbers or of a text file that holds them, see `HELP`.

    Raises SettingError where they are neither, PoseError where they are no rigid transform.
    """
    where, values = f"`extrinsics` {given}", _numbers(str(given))
    if values is None and Path(given).is_file():
        values = _numbers(read_text(Path(given)))
    if values is None:
        raise SettingError(f"{where}: must be {HELP}")
    if len(values) == 7:
        (pose,) = from_quaternions(values[None, :3], values[None, 3:])
        if not np.isfinite(pose).all():
            raise PoseError(f"{where}: its quaternion is no rotation")
        return check_pose(pose, where)
    if len(values) not in (12, 16):
        raise SettingError(f"{where}: must be {HELP}, not {len(values)} numbers")
    return check_pose(np.vstack([values.reshape(-1, 4)[:3], values[12:] if len(values) == 16 else [0, 0, 0, 1]]), where)


def mounted(given: str | Path) -> str:
    """Words that say by which extrinsics poses were moved, and change when others are given."""
    return f"extrinsics {' '.join(f'{value:.9g}' for value in read_extrinsics(given)[:3].reshape(-1))}"


def _numbers(text: str) -> npt.NDArray[np.float64] | None:
    """All of a text; None where it is made of something else."""
    try:
        return np.array([value for _, fields in lines_of(text) for value in to_numbers(fields)])
    except ValueError:
        return None

"""Other tools that find moving points without a GPU, run as their own documentation says, if they are installed."""

import importlib.metadata
import importlib.util
from collections.abc import Callable
from typing import Protocol

import numpy as np

PEER = "dynamic-object-removal"  # on PyPI, MIT licence; run as it is installed, nothing of it is copied here
HINT = f"not installed: pip install {PEER}"
Label = Callable[[np.ndarray, np.ndarray], np.ndarray]  # scan (N, 4), pose T_world_lidar (4, 4) -> moving (N,)


def peers() -> tuple[dict[str, Callable[[], Label]], dict[str, str]]:
    """Starters of the peers that can be run, by row; and the rows that are left out, with the reason.

    `RangeImageGhostFilter` is the tool's filter of a stream of scans by their visibility, with its defaults (5 past
    scans, 0.4 x 1 deg, 0.5 m). Its voxel filter wants three hits of 0.1 m voxels in five scans, which a driving sensor
    seldom gives, and its other methods clean a whole map after the drive.
    """
    if importlib.util.find_spec("dynamic_object_removal") is None:
        return {}, {PEER: HINT}
    from dynamic_object_removal import RangeImageGhostFilter

    return {PEER: lambda: streaming(RangeImageGhostFilter())}, {}


class Filter(Protocol):
    """A filter of a stream: points (N, 3) and origin (3,) in the frame of the world; what stays, and which (N,)."""

    def filter(self, points: np.ndarray, sensor_origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


def versions() -> dict[str, str]:
    """Versions of the peers that are installed."""
    if importlib.util.find_spec("dynamic_object_removal") is None:
        return {}
    return {PEER: importlib.metadata.version(PEER)}


def streaming(tool: Filter) -> Label:
    """A labeller by a filter; points that are not finite count as not moving."""

    def label(scan: np.ndarray, pose: np.ndarray) -> np.ndarray:
        finite = np.isfinite(scan[:, :3]).all(axis=1)
        points = scan[finite, :3].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        _, stays = tool.filter(points, pose[:3, 3])
        moving = np.zeros(len(scan), bool)
        moving[finite] = ~stays
        return moving

    return label

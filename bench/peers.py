"""Other tools that find moving points without a GPU, run as their own documentation says, if they are installed."""

import importlib.metadata
import importlib.util
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

STREAMING = "dynamic-object-removal"  # on PyPI, MIT licence; run as it is installed, nothing of it is copied here
Clouds = list[np.ndarray]
Peer = Callable[
    [Clouds, Clouds], Iterator[np.ndarray]
]  # scans (N, 4), poses T_world_lidar (4, 4) -> moving (N,) of each


def peers() -> tuple[dict[str, Peer], dict[str, str]]:
    """The peers that can be run, by row; and the rows that are left out, with the reason.

    `RangeImageGhostFilter` is the filter of a stream of scans by their visibility, with its defaults (5 past scans,
    0.4 x 1 deg, 0.5 m). Its voxel filter wants three hits of 0.1 m voxels in five scans, which a driving sensor seldom
    gives, and its other methods clean a whole map after the drive.
    """
    if not is_there(STREAMING):
        return {}, {STREAMING: f"not installed: pip install {STREAMING}"}
    from dynamic_object_removal import RangeImageGhostFilter

    return {STREAMING: lambda scans, poses: streaming(RangeImageGhostFilter(), scans, poses)}, {}


def is_there(name: str) -> bool:
    """Whether a distribution is installed."""
    return importlib.util.find_spec(name.replace("-", "_")) is not None


def versions() -> dict[str, str]:
    """Versions of the peers that are installed."""
    return {STREAMING: importlib.metadata.version(STREAMING)} if is_there(STREAMING) else {}


class Filter(Protocol):
    """A filter of a stream: points (N, 3) and origin (3,) in the frame of the world; what stays, and which (N,)."""

    def filter(self, points: np.ndarray, sensor_origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


def streaming(tool: Filter, scans: Clouds, poses: Clouds) -> Iterator[np.ndarray]:
    """Labels by a filter; points that are not finite count as not moving."""
    for scan, pose in zip(scans, poses, strict=True):
        finite = np.isfinite(scan[:, :3]).all(axis=1)
        points = scan[finite, :3].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        _, stays = tool.filter(points, pose[:3, 3])
        moving = np.zeros(len(scan), bool)
        moving[finite] = ~stays
        yield moving

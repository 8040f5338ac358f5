"""Other tools that find moving points without a GPU, run as their own documentation says, if they are installed.

They are run as they are on PyPI: dynamic-object-removal (MIT), DUFOMap (BSD).
"""

import importlib.metadata
import importlib.util
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from bench.scans import entered
from runtime.cleaning.votes import VOXEL

STREAMING, DUFOMAP = "dynamic-object-removal", "dufomap"
Clouds = list[np.ndarray]
Peer = Callable[
    [Clouds, Clouds], Iterator[np.ndarray]
]  # scans (N, 4), poses T_world_lidar (4, 4) -> moving (N,) of each


def peers(threads: int = 2) -> tuple[dict[str, Peer], dict[str, str]]:
    """The peers that can be run, by row; and the rows that are left out, with the reason.

    `RangeImageGhostFilter` is the filter of a stream of scans by their visibility, with its defaults (5 past scans,
    0.4 x 1 deg, 0.5 m). Its voxel filter wants three hits of 0.1 m voxels in five scans, which a driving sensor seldom
    gives, and its other methods clean a whole map after the drive. `dufomap` is the other kind: it labels a scan by all
    scans that it is given, later ones too.
    """
    found: dict[str, Peer] = {}
    if is_there(STREAMING):
        from dynamic_object_removal import RangeImageGhostFilter

        found[STREAMING] = lambda scans, poses: streaming(RangeImageGhostFilter(), scans, poses)
    if is_there(DUFOMAP):
        found[DUFOMAP] = lambda scans, poses: dufomap(scans, poses, threads)
    missing = (name for name in (STREAMING, DUFOMAP) if name not in found)
    return found, {name: f"not installed: pip install {name}" for name in missing}


def is_there(name: str) -> bool:
    """Whether a distribution is installed."""
    return importlib.util.find_spec(name.replace("-", "_")) is not None


def versions() -> dict[str, str]:
    """Versions of the peers that are installed."""
    return {name: importlib.metadata.version(name) for name in (STREAMING, DUFOMAP) if is_there(name)}


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


def dufomap(scans: Clouds, poses: Clouds, threads: int) -> Iterator[np.ndarray]:
    """Labels by what rays went through, as its authors say: all scans first, voxels of 0.1 m, d_s 0.2, d_p 2.

    It fails on points at the origin. These, and all others that take no part here, it is not given: they count as not
    moving.
    """
    from dufomap import dufomap as make

    tool = make(VOXEL, 0.2, 2, num_threads=threads)
    usable = [entered(scan).takes_part for scan in scans]
    for scan, pose, use in zip(scans, poses, usable, strict=True):
        tool.run(scan[use, :3], pose)
    for scan, pose, use in zip(scans, poses, usable, strict=True):
        moving = np.zeros(len(scan), bool)
        moving[use] = tool.segment(scan[use, :3], pose) == 1
        yield moving

"""Labels, predictions and scans on disk in SemanticKITTI's layout, for tests of the evaluation."""

from pathlib import Path

import numpy as np


def write_labels(folder: Path, frames: dict[str, object]) -> Path:
    """`folder/NAME.label` of each name and its labels."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, labels in frames.items():
        np.asarray(labels, "<u4").tofile(folder / f"{name}.label")
    return folder


def write_scans(folder: Path, frames: dict[str, object]) -> Path:
    """`folder/NAME.bin` of each name and its points (N, 4)."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, points in frames.items():
        np.asarray(points, "<f4").reshape(-1, 4).tofile(folder / f"{name}.bin")
    return folder


def at(*distances: float) -> np.ndarray:
    """(N, 4) points at exactly these distances in m, along x, y, z, -x, ... in turn."""
    points = np.zeros((len(distances), 4), np.float32)
    for i, distance in enumerate(distances):
        points[i, i % 3] = distance * (-1) ** (i // 3)
    return points

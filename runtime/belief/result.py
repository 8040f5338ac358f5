"""What a runner says of a scan."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from runtime.head.refiners import PointLabels
from runtime.recordings.poses import Pose


@dataclass(frozen=True)
class MosResult:
    """Labels of one scan. The arrays are the caller's own."""

    moving: NDArray[np.bool_]  # (N,) the point belongs to something that moves
    probability: NDArray[np.float32]  # (N,) that it does: of the point head, or of the point's pixel without one
    ready: bool  # the history was full: all residual images had a scan
    timing: dict[str, float]  # s: "input", "network", "postprocess", "belief", "history", "total"
    index: int  # of the scan, counted since `reset()`
    pose: Pose  # (4, 4) T_world_lidar that the scan was taken to have
    sensor: str  # for which it was labelled, by its name: given, the bundle's, or found in the first scan

    def with_labels(self, labels: PointLabels) -> "MosResult":
        """The same with other labels, those of `moving` and `probability`."""
        return replace(self, moving=labels.moving, probability=labels.probability)

"""Probabilities of moving, counted: which threshold is best on them."""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from runtime.classes import MOVING, STATIC

BINS = 200


class Histogram:
    """Probabilities of moving, counted for the static and the moving class."""

    def __init__(self) -> None:
        self.counts = np.zeros((2, BINS), np.int64)

    def add(self, probability: NDArray[np.float32], labels: NDArray[np.uint8]) -> None:
        """Count probabilities and labels of a scan, of the same shape."""
        bins = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
        self.counts += [np.bincount(bins[labels == label], minlength=BINS) for label in (STATIC, MOVING)]

    def __iadd__(self, other: Self) -> Self:
        """What another one has counted, too."""
        self.counts += other.counts
        return self

    def best_threshold(self, slack: float = 0.0) -> tuple[float, float]:
        """The lowest threshold whose IoU of the moving class is the highest, less at most `slack`; and its IoU.

        False alarms count where they are raised, on scans without a mover too.
        """
        false = self.counts[0][::-1].cumsum()[::-1]  # static ones at or above the lower edge of each bin
        hit = self.counts[1][::-1].cumsum()[::-1]
        iou = hit / np.maximum(1, self.counts[1].sum() + false)
        best = int((iou >= iou.max() - slack).argmax())
        return best / BINS, float(iou[best])

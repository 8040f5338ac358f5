"""Confusion matrix of the classes unlabelled, static, moving, and the scores of the moving class."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.classes import CLASSES, MOVING, STATIC

WIDTH = len(CLASSES)


@dataclass
class Confusion:
    """Counts over all pixels or points added; unlabelled ones (true class 0) are left out of every score."""

    matrix: NDArray[np.int64] = field(default_factory=lambda: np.zeros((WIDTH, WIDTH), np.int64))  # [true, predicted]

    def add(self, labels: ArrayLike, predicted: ArrayLike) -> None:
        """Count pixels or points: true and predicted classes 0..2, arrays of one shape."""
        true = np.asarray(labels).reshape(-1).astype(np.int64)
        guess = np.asarray(predicted).reshape(-1).astype(np.int64)
        self.matrix += np.bincount(true * WIDTH + guess, minlength=WIDTH**2).reshape(WIDTH, WIDTH)

    @property
    def iou(self) -> float:
        """Intersection over union of the moving class; NaN where neither labels nor predictions hold one."""
        hit, missed, false = self.movers
        return _ratio(hit, hit + missed + false)

    @property
    def precision(self) -> float:
        """Share of the predicted movers that move."""
        hit, _, false = self.movers
        return _ratio(hit, hit + false)

    @property
    def recall(self) -> float:
        """Share of the movers that were found."""
        hit, missed, _ = self.movers
        return _ratio(hit, hit + missed)

    @property
    def movers(self) -> tuple[int, int, int]:
        """Counts of the moving class: found ones, missed ones, false alarms."""
        hit = int(self.matrix[MOVING, MOVING])
        return hit, int(self.matrix[MOVING].sum()) - hit, int(self.matrix[STATIC:, MOVING].sum()) - hit


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")

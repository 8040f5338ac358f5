"""Counting predictions against the truth, frame by frame."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from runtime.classes import CLASSES, LABELS, MOVING, label_ids, to_classes
from runtime.errors import MosError, SequenceError, raise_all
from runtime.evaluation.confusion import Confusion
from runtime.evaluation.layout import Frame
from runtime.recordings.labels import read_prediction, read_truth
from runtime.recordings.scans import ScanData

STEP = 10.0  # m, width of a range bin
BINS = ("0-10 m", "10-20 m", "20-30 m", "30-40 m", "40-50 m", "50+ m", "unknown")  # unknown: no scan, or not finite
UNKNOWN = len(BINS) - 1
WIDTH = max(LABELS) + 1


@dataclass
class Counts:
    """Points by range, true label and predicted class; every score is a sum over these."""

    points: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros((len(BINS), WIDTH, len(CLASSES)), np.int64))
    frames: int = 0

    def add(
        self, truth: npt.NDArray[np.uint32], predicted: npt.NDArray[np.uint32], scan: ScanData | None = None
    ) -> None:
        """Count a frame: raw labels of the benchmark, (N,) each; scan (N, >= 3) m for the ranges."""
        where = np.full(len(truth), UNKNOWN) if scan is None else range_bins(scan)
        cell = (where * WIDTH + label_ids(truth)) * len(CLASSES) + to_classes(predicted)
        self.points += np.bincount(cell, minlength=self.points.size).reshape(self.points.shape)
        self.frames += 1

    def __add__(self, other: "Counts") -> "Counts":
        return Counts(self.points + other.points, self.frames + other.frames)

    def total(self) -> Confusion:
        """The benchmark's confusion matrix."""
        return _confusion(self.points.sum(0))

    def by_range(self) -> dict[str, Confusion]:
        """The parts of `total` by distance from the sensor."""
        return {name: _confusion(part) for name, part in zip(BINS, self.points, strict=True)}

    def recall_of(self, label: int) -> tuple[int, int]:
        """Found points and all points of a label of movers (251 to 259)."""
        row = self.points[:, label].sum(0)
        return int(row[MOVING]), int(row.sum())


def range_bins(scan: ScanData) -> npt.NDArray[np.intp]:
    """Index into BINS of every point, (N,), by its distance from the sensor; a bin holds its lower end."""
    points = scan[:, :3].astype(np.float64)  # so that no square of a float32 overflows
    distance = np.sqrt(np.einsum("ij,ij->i", points, points))
    finite = np.isfinite(distance)
    bins = np.minimum(np.where(finite, distance, 0) // STEP, UNKNOWN - 1).astype(np.intp)
    return np.where(finite, bins, UNKNOWN)


def evaluate(
    frames: Iterable[Frame], with_ranges: bool, on_frame: Callable[[], object] = lambda: None
) -> dict[str, Counts]:
    """Counts of each sequence. with_ranges: read the scans too, which all frames then have.

    Raises SequenceError naming every file that cannot be read, has labels that the benchmark does not know, or is
    not of the length of the truth.
    """
    counts: dict[str, Counts] = {}
    problems: list[str] = []
    for frame in frames:
        try:
            truth, predicted, scan = _read(frame, with_ranges)
        except MosError as error:
            problems.append(str(error))
        else:
            counts.setdefault(frame.sequence, Counts()).add(truth, predicted, scan)
        on_frame()
    raise_all(problems, "nothing was scored")
    return counts


def _read(frame: Frame, with_range: bool) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint32], ScanData | None]:
    truth = read_truth(frame.truth)
    predicted = read_prediction(frame.prediction, len(truth))
    if not with_range or frame.scan is None:
        return truth, predicted, None
    recording, index = frame.scan
    scan = recording.read(index)
    if len(scan.points) != len(truth):
        raise SequenceError(
            f"{recording.source}: scan {scan.key} has {len(scan.points)} points, but {frame.truth} labels {len(truth)}"
        )
    return truth, predicted, scan.points


def _confusion(points: npt.NDArray[np.int64]) -> Confusion:
    """(WIDTH, 3) counts by true label as the matrix of classes."""
    classes = to_classes(np.arange(WIDTH, dtype=np.uint32))
    return Confusion(np.stack([points[classes == c].sum(0) for c in range(len(CLASSES))]))

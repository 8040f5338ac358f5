"""What there is to show of a scan: its points, the truth, and what one system or several say."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.classes import MOVING, STATIC, to_classes
from runtime.errors import SequenceError
from runtime.evaluation.confusion import Confusion
from runtime.evaluation.layout import by_stem, find_labels
from runtime.recordings.labels import read_labels
from runtime.recordings.poses import Pose
from runtime.recordings.scans import Scan

if TYPE_CHECKING:
    from runtime.recordings.sequence import Sequence as Recording
    from runtime.runner import MosRunner


@dataclass(frozen=True)
class Snapshot:
    """One scan."""

    sequence: str
    index: int  # of the scan in the sequence, from 0
    scan: str  # file name without suffix
    points: Scan  # (N, 4) float32 x, y, z in m, LiDAR frame, and remission
    pose: Pose  # (4, 4) float64 T_world_lidar
    classes: NDArray[np.uint8] | None  # (N,) true classes: 0 unlabelled, 1 static, 2 moving
    moving: Mapping[str, NDArray[np.bool_]]  # (N,) what each system calls moving

    def iou(self, system: str) -> float | None:
        """Intersection over union of the moving class in this scan: None without truth, NaN where nothing moves."""
        if self.classes is None:
            return None
        confusion = Confusion()
        confusion.add(self.classes, np.where(self.moving[system], MOVING, STATIC))
        return confusion.iou


class System(Protocol):
    """Something that says what moves."""

    name: str

    def moving(self, index: int, points: Scan) -> NDArray[np.bool_]:
        """(N,) of scan `index` of the sequence that it was made for, whose points are (N, 4)."""
        ...


class Stored:
    """Predictions in files, as `mos run` and other tools write them."""

    def __init__(self, root: str | Path, sequence: "Recording", name: str | None = None) -> None:
        """root: with sequences/NN/predictions/*.label, or one such folder, which gives the system its name unless
        there is another. Raises SequenceError where there are none.
        """
        self.name = name or Path(root).resolve().name
        found = find_labels(root, "predictions")
        if sequence.name not in found and len(found) > 1:
            raise SequenceError(f"{root}: has no predictions of sequence {sequence.name}; there are {', '.join(found)}")
        self._folder = found.get(sequence.name) or next(iter(found.values()))
        self._files = by_stem(self._folder)
        self._sequence = sequence

    def moving(self, index: int, points: Scan) -> NDArray[np.bool_]:
        scan = self._sequence.scans[index]
        if scan.stem not in self._files:
            raise SequenceError(
                f"{self._folder / scan.stem}.label: there is no prediction of this scan; choose another scan, or let "
                f"the tool finish the sequence first"
            )
        moving: NDArray[np.bool_] = to_classes(read_labels(self._files[scan.stem], len(points))) == MOVING
        return moving


class Live:
    """A runner, asked while the picture is made. Gives what `mos run` writes, from whichever scan on."""

    def __init__(self, runner: "MosRunner", sequence: "Recording") -> None:
        self.name = runner.bundle.manifest.name
        self._runner, self._sequence = runner, sequence
        self._next = -1  # scan that the runner's history is right for

    def moving(self, index: int, points: Scan) -> NDArray[np.bool_]:
        if index != self._next:
            self._runner.reset()
            for past in range(max(0, index - self._runner.history_length), index):
                self._runner.remember(*self._read(past))
        self._next = index + 1
        return self._runner(*self._read(index)).moving

    def _read(self, index: int) -> tuple[Scan, Pose]:
        return self._sequence.read(index, remission_fill=self._runner.bundle.manifest.sensor.range_image.mean[4])


def snapshots(sequence: "Recording", systems: Sequence[System], indices: Iterable[int]) -> Iterator[Snapshot]:
    """The scans `indices` of a sequence, with labels where it has any.

    Raises ScanError, SequenceError or what a runner raises; with neither systems nor labels a SequenceError.
    """
    for index in indices:
        points, pose = sequence.read(index)
        path = sequence.scans[index]
        classes = _true_classes(path, len(points))
        if classes is None and not systems:
            raise SequenceError(f"{path}: has neither predictions nor labels: there is nothing to show but points")
        moving = {name: system.moving(index, points) for name, system in zip(_names(systems), systems, strict=True)}
        yield Snapshot(sequence.name, index, path.stem, points, pose, classes, moving)


def _true_classes(scan: Path, points: int) -> NDArray[np.uint8] | None:
    """Classes by the label file of a scan, KITTI's way (beside velodyne/) or beside the scans; None without one."""
    folder = scan.parent.parent if scan.parent.name == "velodyne" else scan.parent
    path = folder / "labels" / f"{scan.stem}.label"
    return to_classes(read_labels(path, points)) if path.is_file() else None


def _names(systems: Sequence[System]) -> list[str]:
    """Names of systems, told apart by numbers where two are called alike."""
    names = [system.name for system in systems]
    return [name if names.count(name) == 1 else f"{name} ({i})" for i, name in enumerate(names, 1)]

"""What there is to show of a scan: its points, the truth, and what one system or several say."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.classes import MOVING, STATIC, to_classes
from runtime.errors import SequenceError, some
from runtime.evaluation.confusion import Confusion
from runtime.evaluation.layout import by_stem, find_labels
from runtime.recordings.labels import read_prediction
from runtime.recordings.poses import Pose
from runtime.recordings.recording import Indexed, Scan
from runtime.recordings.registry import as_given

if TYPE_CHECKING:
    from runtime.runner import MosRunner


@dataclass(frozen=True)
class Snapshot:
    """One scan."""

    sequence: str
    index: int  # of the scan in the recording, from 0
    scan: str  # its key
    points: NDArray[np.float32]  # (N, 3) m, LiDAR frame
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

    def moving(self, index: int, scan: Scan) -> NDArray[np.bool_]:
        """(N,) of the scan, which is number `index` of the recording that this was made for."""
        ...


class Stored:
    """Predictions in files, as `mos run` and other tools write them."""

    def __init__(self, root: str | Path, recording: Indexed, name: str | None = None) -> None:
        """root: with sequences/NN/predictions/*.label, or one such folder, which gives the system its name unless
        there is another. Raises SequenceError where there are none.
        """
        self.name = name or as_given(Path(root)).name
        found = find_labels(root, "predictions")
        if recording.name not in found and len(found) > 1:
            there = some(list(found), most=30)
            raise SequenceError(f"{root}: has no predictions of sequence {recording.name}; there are {there}")
        self._folder = found.get(recording.name) or next(iter(found.values()))
        self._files = by_stem(self._folder)

    def moving(self, index: int, scan: Scan) -> NDArray[np.bool_]:
        if scan.key not in self._files:
            raise SequenceError(
                f"{self._folder / scan.key}.label: there is no prediction of this scan; choose another scan, or let "
                f"the tool finish the sequence first"
            )
        moving: NDArray[np.bool_] = to_classes(read_prediction(self._files[scan.key], len(scan.data))) == MOVING
        return moving


class Live:
    """A runner, asked while the picture is made. Gives what `mos run` writes, from whichever scan on."""

    def __init__(self, runner: "MosRunner", recording: Indexed) -> None:
        self.name = runner.bundle.manifest.name
        self._runner, self._recording = runner, recording
        self._next = -1  # scan that the runner's history is right for

    def moving(self, index: int, scan: Scan) -> NDArray[np.bool_]:
        if index != self._next:
            self._choose_sensor()
            self._runner.reset(keep_sensor=True)
            for past in range(max(0, index - self._runner.history_length), index):
                self._runner.remember(self._recording.read(past))
        self._next = index + 1
        return self._runner(scan).moving

    def _choose_sensor(self) -> None:
        """By the first scan of the recording that shows it."""
        for first in range(len(self._recording)):
            if self._runner.sensor:
                return
            scan = self._recording.read(first)
            self._runner.choose_sensor(scan.data, scan.ring)


def snapshots(recording: Indexed, systems: Sequence[System], indices: Iterable[int]) -> Iterator[Snapshot]:
    """The scans `indices` of a recording, with labels where it has any.

    Raises ScanError, SequenceError or what a runner raises; with neither systems nor labels a SequenceError.
    """
    for index in indices:
        scan, labels = recording.read(index), recording.labels(index)
        classes = None if labels is None else to_classes(labels)
        if classes is None and not systems:
            where = f"{recording.source}: scan {scan.key}"
            raise SequenceError(f"{where} has neither predictions nor labels: there is nothing to show but points")
        moving = {name: system.moving(index, scan) for name, system in zip(_names(systems), systems, strict=True)}
        yield Snapshot(recording.name, index, scan.key, scan.points, scan.known_pose(), classes, moving)


def _names(systems: Sequence[System]) -> list[str]:
    """Names of systems, told apart by numbers where two are called alike."""
    names = [system.name for system in systems]
    return [name if names.count(name) == 1 else f"{name} ({i})" for i, name in enumerate(names, 1)]

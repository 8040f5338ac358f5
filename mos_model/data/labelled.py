"""Recordings with true labels, all of it checked before training starts: it should not fail hours later, nor learn
from what is wrong."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mos_model.data.dataset import Frame, SampleConfig, make_frame
from runtime.bundle.residual import HISTORY
from runtime.classes import MOVING, UNLABELLED, to_classes
from runtime.doctor.demand import demand_fit
from runtime.errors import MosError, SequenceError, raise_all, some
from runtime.recordings.recording import DEFAULTS, Indexed, Options
from runtime.recordings.registry import find_recordings
from runtime.sensors.range_image import RangeImage

READERS = 8  # threads that read labels
SO = "training does not start"


@dataclass(frozen=True)
class Labelled:
    """A recording whose labels have been read and counted. Picklable, if the recording is."""

    scans: Indexed
    moving: NDArray[np.int64]  # (T,) points of each scan
    labelled: NDArray[np.int64]  # (T,) the same, moving or static

    def __len__(self) -> int:
        return len(self.scans)

    def history(self, index: int, config: SampleConfig) -> list[Frame | None]:
        """The scans before `index`, the oldest first (None before the start), then scan `index` itself with classes.

        Raises ScanError, PoseError or SequenceError.
        """
        past = [self._frame(i, config, labelled=False) if i >= 0 else None for i in range(index - HISTORY, index)]
        return [*past, self._frame(index, config)]

    def _frame(self, index: int, config: SampleConfig, labelled: bool = True) -> Frame:
        scan = self.scans.read(index)
        classes = _classes(self.scans, index) if labelled else np.full(len(scan.data), UNLABELLED, np.uint8)
        return make_frame(scan.data, scan.known_pose(), classes, config)


def open_labelled(
    root: Path, names: Sequence[str], image: RangeImage, options: Options = DEFAULTS, trusted: bool = False
) -> list[Labelled]:
    """The recordings of these names below `root`, looked at as by `mos doctor`, for networks that see `image`.

    trusted: not looked at, as of the simulator, whose poses are right whatever so few scans look like.

    Raises SequenceError that names what is missing, what the doctor calls bad, and labels that are none. Warns
    (MosWarning) of the rest.
    """
    opened = _open(root, names, options)
    if not trusted:
        demand_fit(opened, image, SO)
    counted, problems = [], []
    for recording in opened:
        try:
            counted.append(_counted(recording))
        except MosError as error:
            problems.append(str(error))
    raise_all(problems, SO)
    return counted


def demand_movers(recordings: Sequence[Labelled], use: str) -> None:
    """Raise SequenceError where none of the recordings has a moving point, or none a labelled one.

    use: what they are for, in words.
    """
    names = some([recording.scans.name for recording in recordings], most=10)
    scans = sum(map(len, recordings))
    if not any(recording.labelled.any() for recording in recordings):
        raise SequenceError(f"{use} ({names}): no point of {scans} scans has a label, so {SO}")
    if not any(recording.moving.any() for recording in recordings):
        raise SequenceError(f"{use} ({names}): no point of {scans} scans is labelled as moving, so {SO}")


def _open(root: Path, names: Sequence[str], options: Options) -> list[Indexed]:
    there = {found.path.name: found for found in find_recordings(root)}
    missing = [name for name in names if name not in there]
    problems = [f"{root}: has no sequence {', '.join(missing)}; there are {some(list(there), most=30)}"] * bool(missing)
    opened = []
    for name in names:
        try:
            opened += [there[name].open(options)] if name in there else []
        except MosError as error:
            problems.append(str(error))
    raise_all(problems, SO)
    return opened


def _counted(recording: Indexed) -> Labelled:
    """Read all labels. Raises SequenceError."""

    def count(index: int) -> NDArray[np.int64]:
        return np.bincount(_classes(recording, index), minlength=MOVING + 1)

    with ThreadPoolExecutor(READERS) as pool:
        counts = np.array(list(pool.map(count, range(len(recording)))), np.int64)
    return Labelled(recording, counts[:, MOVING], counts.sum(1) - counts[:, UNLABELLED])


def _classes(recording: Indexed, index: int) -> NDArray[np.uint8]:
    """Classes (N,) of a scan. Raises SequenceError where it has no labels or they are none."""
    labels = recording.labels(index)
    if labels is None:
        raise SequenceError(f"{recording.source}: scan {recording.keys[index]} has no labels")
    return to_classes(labels)

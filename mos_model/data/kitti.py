"""SemanticKITTI-MOS, KITTI-Road-MOS and whatever is laid out like them (`mos simulate` writes it).

root/sequences/NN/{velodyne/*.bin, labels/*.label, poses.txt, calib.txt}. Everything is checked when it is
opened, so that training does not fail hours later; no residual image is ever stored.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mos_model.data.dataset import Frame, Sample, SampleConfig, make_frame, make_samples
from runtime.bundle.residual import HISTORY
from runtime.classes import MOVING, UNLABELLED, to_classes
from runtime.errors import MosError, SequenceError
from runtime.recordings.labels import LABEL_BYTES, read_truth
from runtime.recordings.recording import Indexed
from runtime.recordings.registry import open_recording as open_scans
from runtime.sensors.range_image import RangeImage

TRAIN = ("00", "01", "02", "03", "04", "05", "06", "07", "09", "10")
VALIDATION = ("08",)
TEST = tuple(f"{number}" for number in range(11, 22))
ROAD_TRAIN = ("30", "31", "32", "33", "34", "40")
ROAD_VALIDATION = ("35", "36", "37", "38", "39", "41")

DYNAMIC_POINTS = 100  # a frame with more moving points is dynamic
STATIC_EVERY = 10  # of a run of static frames, one in so many is kept
READERS = 8  # threads that read labels


@dataclass(frozen=True)
class Recording:
    """A labelled sequence, its files checked."""

    scans: Indexed
    labels: tuple[Path, ...]

    def frame(self, index: int, sensor: RangeImage, labelled: bool = True) -> Frame:
        """Scan `index` with its classes (all unlabelled if not `labelled`). Raises ScanError or SequenceError."""
        scan = self.scans.read(index)
        count = len(scan.data)
        classes = self.classes(index, count) if labelled else np.full(count, UNLABELLED, np.uint8)
        return make_frame(scan.data, scan.known_pose(), classes, sensor)

    def classes(self, index: int, points: int | None = None) -> NDArray[np.uint8]:
        """Classes (N,) of scan `index`; `points`: as many must be there."""
        path = self.labels[index]
        return to_classes(read_truth(path, points))

    def history(self, index: int, sensor: RangeImage) -> list[Frame | None]:
        """The scans before `index`, the oldest first (None before the start), then scan `index` itself."""
        past = [self.frame(i, sensor, labelled=False) if i >= 0 else None for i in range(index - HISTORY, index)]
        return [*past, self.frame(index, sensor)]


def open_recording(folder: Path) -> Recording:
    """A sequence folder. Raises SequenceError that names what is missing or does not fit."""
    scans = open_scans(folder)
    labels = tuple(folder / "labels" / f"{key}.label" for key in scans.keys)
    missing = [path for path in labels if not path.is_file()]
    if missing:
        raise SequenceError(
            f"{folder}: {len(missing)} of {len(labels)} scans have no labels, the first is {missing[0]}"
        )
    for index, label in enumerate(labels):
        points, size = scans.count(index), label.stat().st_size
        if size != LABEL_BYTES * points:
            raise SequenceError(f"{label}: {size} bytes are not the labels of the {points} points of its scan")
    return Recording(scans, labels)


def open_recordings(root: Path, names: Sequence[str]) -> list[Recording]:
    """The named sequences under root/sequences. Raises SequenceError that names all that is wrong."""
    recordings, problems = [], []
    for name in names:
        folder = root / "sequences" / name
        if not folder.is_dir():
            problems.append(f"{folder} does not exist")
            continue
        try:
            recordings.append(open_recording(folder))
        except MosError as error:
            problems.append(str(error))
    if problems:
        more = f"; and {len(problems) - 5} more" if len(problems) > 5 else ""
        raise SequenceError(f"the data set is not complete: {'; '.join(problems[:5])}{more}")
    return recordings


def count_moving(recordings: Sequence[Recording]) -> list[NDArray[np.int64]]:
    """Moving points of every frame of each recording. Reads and checks all labels."""
    frames = [(recording, i) for recording in recordings for i in range(len(recording.scans))]

    def count(frame: tuple[Recording, int]) -> int:
        recording, i = frame
        return int((recording.classes(i) == MOVING).sum())

    with ThreadPoolExecutor(READERS) as pool:
        counts = np.array(list(pool.map(count, frames)), np.int64)
    ends = np.cumsum([len(recording.scans) for recording in recordings])[:-1]
    return np.split(counts, ends)


def thin_static(moving: NDArray[np.int64], every: int = STATIC_EVERY) -> NDArray[np.intp]:
    """Indices of the frames to train on: the dynamic ones and, of each run of static ones, one in `every`."""
    dynamic = moving > DYNAMIC_POINTS
    position = np.arange(len(moving))
    last_dynamic = np.maximum.accumulate(np.where(dynamic, position, -1))
    return np.flatnonzero(dynamic | ((position - last_dynamic - 1) % every == 0))


@dataclass(frozen=True)
class RecordedFrames:
    """Frames of recordings; a group is one frame. Endless and shuffled anew every epoch, or in order."""

    samples: SampleConfig
    recordings: tuple[Recording, ...]
    frames: tuple[tuple[int, int], ...]  # (recording, scan)
    seed: int = 0
    shuffle: bool = True
    crops: int = 1

    @property
    def group_size(self) -> int:
        """Samples of a frame."""
        return self.crops if self.samples.crop else 1

    def group(self, number: int) -> list[Sample]:
        """The samples of a frame, with what history it has."""
        epoch, position = divmod(number, len(self.frames))
        if self.shuffle:
            position = epoch_order(self.seed, epoch, len(self.frames))[position]
        recording, index = self.frames[position]
        rng = np.random.default_rng((self.seed, 2, number))
        frames = self.recordings[recording].history(index, self.samples.sensor)
        return make_samples(frames, self.samples, rng, self.crops)


@lru_cache(maxsize=2)
def epoch_order(seed: int, epoch: int, count: int) -> NDArray[np.int64]:
    """The order of the frames in an epoch."""
    return np.random.default_rng((seed, 3, epoch)).permutation(count)


def training_frames(samples: SampleConfig, recordings: Sequence[Recording], seed: int, crops: int) -> RecordedFrames:
    """All dynamic frames and a part of the static ones."""
    kept = [thin_static(moving) for moving in count_moving(recordings)]
    frames = tuple((r, int(i)) for r, indices in enumerate(kept) for i in indices)
    return RecordedFrames(samples, tuple(recordings), frames, seed, crops=crops)


def validation_frames(samples: SampleConfig, recordings: Sequence[Recording]) -> RecordedFrames:
    """All frames in order."""
    frames = tuple((r, i) for r, recording in enumerate(recordings) for i in range(len(recording.scans)))
    return RecordedFrames(samples, tuple(recordings), frames, shuffle=False)

"""Samples of recordings: which frames of them, and in which order. No residual image is ever stored."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mos_model.data.dataset import Sample, SampleConfig, make_samples
from mos_model.data.labelled import Labelled

DYNAMIC_POINTS = 100  # a frame with more moving points is dynamic
STATIC_EVERY = 10  # of a run of static frames, one in so many is kept


@dataclass(frozen=True)
class RecordedFrames:
    """Frames of recordings; a group is one frame. Endless and shuffled anew every epoch, or in order."""

    samples: SampleConfig
    recordings: tuple[Labelled, ...]
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
        return make_samples(self.recordings[recording].history(index, self.samples), self.samples, rng, self.crops)


def training_frames(samples: SampleConfig, recordings: Sequence[Labelled], seed: int, crops: int) -> RecordedFrames:
    """All dynamic frames and a part of the static ones."""
    kept = [thin_static(recording.moving) for recording in recordings]
    frames = tuple((r, int(i)) for r, indices in enumerate(kept) for i in indices)
    return RecordedFrames(samples, tuple(recordings), frames, seed, crops=crops)


def validation_frames(samples: SampleConfig, recordings: Sequence[Labelled]) -> RecordedFrames:
    """All frames in order."""
    frames = tuple((r, i) for r, recording in enumerate(recordings) for i in range(len(recording)))
    return RecordedFrames(samples, tuple(recordings), frames, shuffle=False)


def thin_static(moving: NDArray[np.int64], every: int = STATIC_EVERY) -> NDArray[np.intp]:
    """Indices of the frames to train on: the dynamic ones and, of each run of static ones, one in `every`."""
    dynamic = moving > DYNAMIC_POINTS
    position = np.arange(len(moving))
    last_dynamic = np.maximum.accumulate(np.where(dynamic, position, -1))
    return np.flatnonzero(dynamic | ((position - last_dynamic - 1) % every == 0))


@lru_cache(maxsize=2)
def epoch_order(seed: int, epoch: int, count: int) -> NDArray[np.int64]:
    """The order of the frames in an epoch."""
    return np.random.default_rng((seed, 3, epoch)).permutation(count)

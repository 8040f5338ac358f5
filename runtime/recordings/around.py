"""A recording as it is seen through something: with other poses, or points that were moved."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.recordings.poses import Poses
from runtime.recordings.recording import Indexed, Scan


class Around(Indexed):
    """The recording within, until something is changed about it."""

    def __init__(self, within: Indexed) -> None:
        self.within = within
        self.name, self.source, self.sensor = within.name, within.source, within.sensor
        self.keys, self.times = within.keys, within.times
        self.poses, self.poses_from, self.lost = within.poses, within.poses_from, within.lost

    def seen(self, index: int, scan: Scan) -> Scan:
        """Scan number `index`, of `scan` as it is within."""
        raise NotImplementedError

    def read(self, index: int) -> Scan:
        return self.seen(index, self.within.read(index))

    def scans(self, start: int = 0) -> Iterator[Scan]:
        return (self.seen(index, scan) for index, scan in enumerate(self.within.scans(start), start))

    def count(self, index: int) -> int:
        return self.within.count(index)

    def remission_scale(self) -> float | None:
        return self.within.remission_scale()

    def labels(self, index: int) -> npt.NDArray[np.uint32] | None:
        return self.within.labels(index)

    def write_kept(self, folder: Path, kept: Iterator[tuple[int, npt.NDArray[np.bool_]]]) -> None:
        self.within.write_kept(folder, kept)

    def check_takes_labels(self) -> None:
        self.within.check_takes_labels()

    def write_labelled(
        self, folder: Path, labelled: Iterator[tuple[int, npt.NDArray[np.bool_], npt.NDArray[np.float32]]]
    ) -> None:
        self.within.write_labelled(folder, labelled)

    def other_poses(self) -> dict[str, Poses]:
        return self.within.other_poses()


class Called(Around):
    """Under the name of the place that it is a copy of."""

    def __init__(self, within: Indexed, source: str) -> None:
        super().__init__(within)
        self.source = source

    def seen(self, index: int, scan: Scan) -> Scan:
        return scan


class Beginning(Around):
    """Only the first scans."""

    def __init__(self, within: Indexed, count: int) -> None:
        super().__init__(within)
        self.keys = within.keys[:count]
        self.times = None if within.times is None else within.times[:count]
        self.poses = None if within.poses is None else within.poses[:count]

    def seen(self, index: int, scan: Scan) -> Scan:
        return scan

    def scans(self, start: int = 0) -> Iterator[Scan]:
        return islice(self.within.scans(start), max(0, len(self) - start))

    def other_poses(self) -> dict[str, Poses]:
        return {meaning: poses[: len(self)] for meaning, poses in self.within.other_poses().items()}

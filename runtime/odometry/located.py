"""A recording without poses, with those that an odometry finds."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from runtime.errors import MosError, PoseError
from runtime.odometry.odometry import Odometry, located, name_of
from runtime.recordings.around import Around
from runtime.recordings.poses import Poses
from runtime.recordings.recording import Indexed, Scan

Progress = Callable[[int, int], object]  # of done, total


@dataclass(frozen=True)
class FoundPoses:
    """What an odometry found."""

    odometry: str  # its name
    poses: Poses  # (T, 4, 4) T_world_lidar; NaN where a scan could not be read, or was not asked for
    lost: dict[int, str] = field(default_factory=dict)  # see `Scan.lost`, by number
    scans: str = ""  # `Digest` of those that they are of


def find_poses(
    recording: Indexed,
    odometry: Odometry,
    chosen: range | None = None,
    deskew: bool = True,
    on_progress: Progress = lambda done, total: None,
) -> FoundPoses:
    """The poses of the scans of a recording; in one pass, of which only poses are kept.

    chosen: some consecutive scans; None: all. deskew: the odometry is told when each point was measured. A scan that
    cannot be read is left out. Raises what the odometry raises.
    """
    chosen = range(len(recording)) if chosen is None else chosen
    poses = np.full((len(recording), 4, 4), np.nan)
    lost: dict[int, str] = {}
    digest = Digest(deskew)
    for index, scan in readable(recording, chosen, on_progress):
        digest.add(recording.fingerprint(scan))
        pose, why = located(odometry, scan.data, scan.time, scan.times if deskew else None)
        poses[index] = pose
        if why:
            lost[index] = why
    return FoundPoses(name_of(odometry), poses, lost, digest.text())


def readable(recording: Indexed, chosen: range, on_progress: Progress) -> Iterator[tuple[int, Scan]]:
    """Those of the chosen scans that can be read, with their numbers."""
    on_progress(0, len(chosen))
    scans = recording.scans(chosen.start)
    for index in chosen:
        try:
            yield index, next(scans)
        except MosError:  # is said when it is labelled
            scans = recording.scans(index + 1)
        on_progress(index + 1 - chosen.start, len(chosen))


class Digest:
    """Of what an odometry was given."""

    def __init__(self, deskew: bool) -> None:
        self._hash = hashlib.blake2b(str(deskew).encode(), digest_size=16)

    def add(self, fingerprint: str) -> None:
        self._hash.update(fingerprint.encode())

    def text(self) -> str:
        return self._hash.hexdigest()


class Located(Around):
    """The recording with poses that were found."""

    def __init__(self, within: Indexed, found: FoundPoses) -> None:
        super().__init__(within)
        self.poses, self.lost, self.poses_from = found.poses, found.lost, found.odometry

    def seen(self, index: int, scan: Scan) -> Scan:
        assert self.poses is not None
        pose = self.poses[index]
        if not np.isfinite(pose).all():
            raise PoseError(f"{self.source}: scan {scan.key} has no pose: {self.poses_from} was not asked for it")
        return replace(scan, pose=pose, lost=self.lost.get(index, ""))

    def other_poses(self) -> dict[str, Poses]:
        return {}  # it is known what they mean

"""Recordings of one file a scan, with pose, calibration, time and label files beside them."""

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import MosError, PoseError, SequenceError
from runtime.files import write_whole
from runtime.recordings.cloud import Cloud
from runtime.recordings.formats.registry import SUFFIXES, count_points, find_columns, kept_points, read_cloud
from runtime.recordings.labels import read_truth
from runtime.recordings.point_times import PointTimes
from runtime.recordings.pose_files import ScanPoses, Times, read_file_poses, read_times
from runtime.recordings.poses import Pose, Poses
from runtime.recordings.recording import Indexed, Options, Scan
from runtime.recordings.remission import FIRST, Remission
from runtime.recordings.scans import moved


@dataclass(frozen=True, kw_only=True)
class ScanFiles(Indexed):
    """The scans of a folder; `open_files` makes it."""

    name: str
    source: str
    sensor: str | None
    poses_from: str | None
    keys: tuple[str, ...]
    poses: Poses | None
    times: npt.NDArray[np.float64] | None
    folder: Path  # in which all other files lie
    files: tuple[Path, ...]  # of the scans
    file_poses: ScanPoses | None
    columns: int  # numbers a point, if they are raw
    remission: Remission
    point_times: PointTimes
    mount: Pose | None  # (4, 4) T_file_lidar, where the points of the files are in another frame than the LiDAR's

    def read(self, index: int) -> Scan:
        if self.file_poses is not None and index in self.file_poses.broken:
            raise PoseError(self.file_poses.broken[index])
        cloud = read_cloud(self.files[index], self.columns)
        time = None if self.times is None else float(self.times[index])
        return Scan(
            self.keys[index],
            self.remission.scaled(cloud.data if self.mount is None else moved(cloud.data, np.linalg.inv(self.mount))),
            None if self.poses is None else self.poses[index],
            time,
            cloud.ring,
            self.point_times.seconds(cloud.times, time),
        )

    def count(self, index: int) -> int:
        return count_points(self.files[index], self.columns)

    def remission_scale(self) -> float | None:
        return self.remission.scale

    def labels(self, index: int) -> npt.NDArray[np.uint32] | None:
        path = self.folder / "labels" / f"{self.keys[index]}.label"
        return read_truth(path, self.count(index)) if path.is_file() else None

    def write_kept(self, folder: Path, kept: Iterator[tuple[int, npt.NDArray[np.bool_]]]) -> None:
        for index, keep in kept:
            path = folder / self.files[index].relative_to(self.folder)
            write_whole(path, kept_points(self.files[index], keep, self.columns), sync=False)

    def other_poses(self) -> dict[str, Poses]:
        return {} if self.file_poses is None else self.file_poses.others()


def open_files(folder: Path, scans: Path, options: Options) -> ScanFiles:
    """The files of the folder `scans`, and what lies in `folder`: poses, calib.txt, times.txt, labels/.

    Raises SequenceError or PoseError.
    """
    files = list_scans(scans)
    times = None if options.points_only else read_times(folder / "times.txt", files, options.limit)
    found = read_file_poses(folder, files, options, times) if options.reads_poses else None
    return of_files(folder, files, options, found, times)


def of_files(
    folder: Path,
    files: tuple[Path, ...],
    options: Options,
    found: ScanPoses | None,
    times: Times | None,
    mount: Pose | None = None,
    compensated: bool = False,
) -> ScanFiles:
    """The first `options.limit` of these files, with their poses and times.

    mount: see `ScanFiles`. compensated: the points are of one time, whatever the files say of when they were measured.
    """
    columns = options.columns or find_columns(files[:FIRST])
    first = partial(_readable, files[:FIRST], columns)  # unlike a lambda, it goes to other processes
    files = files[: options.limit]
    return ScanFiles(
        name=folder.name,
        source=str(folder),
        sensor=None,
        poses_from=None if found is None else found.origin,
        keys=tuple(file.stem for file in files),
        poses=None if found is None else found.poses,
        times=times,
        folder=folder,
        files=files,
        file_poses=found,
        columns=columns,
        remission=Remission(options.remission_scale, str(folder), first),
        point_times=PointTimes(str(folder), partial(_readable, (), columns) if compensated else first),
        mount=mount,
    )


def _readable(files: tuple[Path, ...], columns: int) -> Iterator[Cloud]:
    """The clouds in those files that can be read; what is wrong with the others is said when it is their turn."""
    for file in files:
        with suppress(MosError):
            yield read_cloud(file, columns)


def scan_files(folder: Path) -> list[Path]:
    """Files of a folder that are scans by their names, in no order; links that lead nowhere too: they are missed."""
    with os.scandir(folder) as entries:
        return [
            folder / entry.name
            for entry in entries
            if entry.name.lower().endswith(SUFFIXES) and not entry.name.startswith(".") and not entry.is_dir()
        ]


def list_scans(folder: Path) -> tuple[Path, ...]:
    """Scan files of a folder in the order of their numbers. Raises SequenceError."""
    files = scan_files(folder)
    if not files:
        raise SequenceError(f"{folder}: holds no scans: no file ends with {', '.join(SUFFIXES)}")
    first = min(files)
    if other := next((file for file in files if _pattern(file) != _pattern(first)), None):
        raise SequenceError(
            f"{folder}: {first.name} and {other.name} are not named alike, so that their order "
            f"is not known; leave in only the scans of one recording, numbered in order of time"
        )
    files.sort(key=_order)
    for one, two in pairwise(files):
        if _order(one) == _order(two):
            raise SequenceError(f"{folder}: {one.name} and {two.name} have the same number")
    return tuple(files)


def _pattern(file: Path) -> str:
    return re.sub(r"\d+", "#", file.name.lower())


def _order(file: Path) -> tuple[int | str, ...]:
    """Numbers by value, decimals (times such as 12.5) as text: within one pattern the types agree."""
    tokens = re.findall(r"(?<=\d)\.\d+|\d+|\D+", file.stem.lower())
    return tuple(int(token) if token.isdigit() else token for token in tokens)

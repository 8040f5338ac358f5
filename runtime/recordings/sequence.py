"""Finding a sequence: scan files in order of time, and the pose of the LiDAR for each of them.

Two layouts are known. KITTI: `root/sequences/NN/velodyne/*.bin` with `calib.txt` and `poses.txt` in `NN`, the
latter also as `root/poses/NN.txt`. Plain: a folder of .bin or .npy files with `poses.txt` in it.
"""

import hashlib
import re
import warnings
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from runtime.errors import MosWarning, PoseError, SequenceError, SettingError
from runtime.recordings.poses import Pose, Poses, camera_to_lidar, check_pose, read_calib, read_poses
from runtime.recordings.scans import SUFFIXES, Scan, read_scan

FRAMES = ("camera", "lidar")  # what the poses of a file may be poses of


@dataclass(frozen=True)
class Sequence:
    """A recording whose scans and poses fit together."""

    name: str
    scans: tuple[Path, ...]  # in order of time
    poses: Poses  # (len(scans), 4, 4) float64 T_world_lidar, checked
    poses_sha256: str  # of the files that the poses come from

    def __len__(self) -> int:
        return len(self.scans)

    def read(self, index: int, remission_fill: float = 0.0) -> tuple[Scan, Pose]:
        """Scan (N, 4) float32 and pose (4, 4) float64. Raises ScanError."""
        return read_scan(self.scans[index], remission_fill), self.poses[index]


@dataclass(frozen=True)
class PoseFiles:
    """Where the poses of a sequence come from."""

    poses: Path
    calib: Path | None  # None: the poses are the LiDAR's own

    @property
    def frame(self) -> str:
        return "lidar" if self.calib is None else "camera"

    def read(self) -> Poses:
        """T_world_lidar of every line, (T, 4, 4) float64. Raises PoseError."""
        poses = read_poses(self.poses)
        return poses if self.calib is None else camera_to_lidar(poses, read_calib(self.calib))

    def sha256(self) -> str:
        files = [self.poses] if self.calib is None else [self.poses, self.calib]
        return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()


def find_sequences(path: str | Path, names: tuple[str, ...] = ()) -> list[Path]:
    """Sequence folders under `path`: itself, or those of `path/sequences`, of which `names` picks some.

    Raises SequenceError where there is none.
    """
    path = Path(path).resolve()
    if not path.is_dir():
        raise SequenceError(f"{path}: is no folder; give a sequence, a root with 'sequences', or a folder of scans")
    if path.name == "velodyne":
        path = path.parent
    if (path / "velodyne").is_dir() or any(file.suffix in SUFFIXES for file in path.iterdir()):
        if names:
            raise SequenceError(f"{path}: is one sequence; leave out --sequence or give the root above it")
        return [path]
    root = path / "sequences" if (path / "sequences").is_dir() else path
    found = {folder.name: folder for folder in sorted(root.iterdir()) if (folder / "velodyne").is_dir()}
    if not found:
        raise SequenceError(f"{path}: holds neither 'velodyne' nor 'sequences/NN/velodyne' nor .bin or .npy scans")
    missing = [name for name in names if name not in found]
    if missing:
        raise SequenceError(f"{root}: has no sequence {', '.join(missing)}; there are {', '.join(found)}")
    return [found[name] for name in names] if names else list(found.values())


def list_scans(folder: str | Path) -> tuple[Path, ...]:
    """Scan files of a sequence folder in the order of their numbers. Raises SequenceError."""
    folder = Path(folder)
    scans_folder = folder / "velodyne" if (folder / "velodyne").is_dir() else folder
    files = [file for file in scans_folder.iterdir() if file.suffix in SUFFIXES and not file.name.startswith(".")]
    if not files:
        raise SequenceError(f"{scans_folder}: holds no .bin or .npy scans")
    pattern = _pattern(min(files))
    for file in files:
        if _pattern(file) != pattern:
            raise SequenceError(
                f"{scans_folder}: {min(files).name} and {file.name} are not named alike, so that their order "
                f"is not known; leave in only the scans of one sequence, numbered in order of time"
            )
    files.sort(key=_order)
    for first, second in pairwise(files):
        if _order(first) == _order(second):
            raise SequenceError(f"{scans_folder}: {first.name} and {second.name} have the same number")
    return tuple(files)


def find_pose_files(
    folder: str | Path,
    poses: str | Path | None = None,
    calib: str | Path | None = None,
    frame: str | None = None,
) -> PoseFiles:
    """Pose and calibration file of a sequence folder, each as given or else where KITTI keeps it.

    frame: "camera" (KITTI; needs calib.txt), "lidar" (T_world_lidar, no calib.txt), None: camera. Raises PoseError
    saying where a file was looked for.
    """
    folder = Path(folder)
    if frame not in (None, *FRAMES):
        raise SettingError(f"the pose frame must be camera or lidar, not {frame!r}")
    usual = [folder / "poses.txt", folder.parent.parent / "poses" / f"{folder.name}.txt"]
    pose_file = _first_file([Path(poses)] if poses else usual)
    if pose_file is None:
        looked = poses or f"{usual[0]} or {usual[1]}"
        raise PoseError(f"no poses: {looked} does not exist; give the file by --poses")
    if frame == "lidar":
        return PoseFiles(pose_file, None)
    calib_file = _first_file([Path(calib) if calib else folder / "calib.txt"])
    if calib_file is None:
        raise PoseError(
            f"no calibration: {calib or folder / 'calib.txt'} does not exist. KITTI poses are the camera's "
            f"and need the line 'Tr:' of its calib.txt (--calib FILE); if yours are the LiDAR's own, say "
            f"--pose-frame lidar"
        )
    return PoseFiles(pose_file, calib_file)


def open_sequence(
    folder: str | Path,
    poses: str | Path | None = None,
    calib: str | Path | None = None,
    frame: str | None = None,
    limit: int | None = None,
) -> Sequence:
    """The sequence in `folder`, or its first `limit` scans; poses as in `find_pose_files`.

    Line n of the pose file belongs to the n-th scan. Where it has more lines than there are scans, as with an
    excerpt of a long sequence, line n belongs to the scan numbered n, from 0. Raises SequenceError or
    PoseError.
    """
    folder = Path(folder).resolve()
    scans = list_scans(folder)
    files = find_pose_files(folder, poses, calib, frame)
    every = files.read()
    lines = match_poses(scans, len(every), files.poses, limit)
    scans = scans[: len(lines)]
    chosen = every[lines]
    for scan, line, pose in zip(scans, lines, chosen, strict=True):
        check_pose(pose, f"{files.poses}: pose {line} (from 0, scan {scan.name})")
    return Sequence(folder.name, scans, chosen, files.sha256())


def match_poses(scans: tuple[Path, ...], poses: int, file: Path, limit: int | None = None) -> list[int]:
    """Index of the pose of each of the first `limit` scans. Raises SequenceError where they do not fit."""
    used = len(scans) if limit is None else min(limit, len(scans))
    if poses == len(scans) or used <= poses < len(scans):
        return list(range(used))
    if poses < used:
        raise SequenceError(
            f"{file}: {poses} poses for {used} scans in {scans[0].parent}; "
            f"give the whole file by --poses, or run the first scans by --limit {poses}"
        )
    numbers = [int(scan.stem) for scan in scans if scan.stem.isdigit()]
    if len(numbers) < len(scans) or numbers[-1] >= poses:
        raise SequenceError(
            f"{file}: {poses} poses for {len(scans)} scans in {scans[0].parent}, whose names do not tell "
            f"which pose is whose; give a pose file with one line for each scan"
        )
    if numbers != list(range(len(scans))):
        warnings.warn(
            f"{file}: {poses} poses for {len(scans)} scans: each scan takes the line of its number "
            f"({numbers[0]} to {numbers[-1]}, from 0)",
            MosWarning,
            stacklevel=2,
        )
    return numbers[:used]


def scan_number(scan: Path) -> int | None:
    """The number in a scan's file name, None where there is none or several."""
    numbers = re.findall(r"\d+", scan.stem)
    return int(numbers[0]) if len(numbers) == 1 else None


def _pattern(file: Path) -> str:
    return re.sub(r"\d+", "#", file.name)


def _order(file: Path) -> tuple[int | str, ...]:
    """Numbers by value, decimals (times such as 12.5) as text: within one pattern the types agree."""
    tokens = re.findall(r"(?<=\d)\.\d+|\d+|\D+", file.stem)
    return tuple(int(token) if token.isdigit() else token for token in tokens)


def _first_file(files: list[Path]) -> Path | None:
    return next((file for file in files if file.is_file()), None)

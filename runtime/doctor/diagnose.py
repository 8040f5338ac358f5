"""`mos doctor`: looks at a sequence and says in plain words what does not fit the network."""

import warnings
from pathlib import Path

import numpy as np

from runtime.doctor.check_poses import check_alignment, check_rigid, check_steps, check_times, other_readings
from runtime.doctor.check_scans import Samples, check_files, check_points, check_sensor
from runtime.doctor.findings import Finding
from runtime.errors import MosError, MosWarning, ScanError
from runtime.recordings.poses import read_poses
from runtime.recordings.scans import Scan, read_scan
from runtime.recordings.sequence import find_pose_files, list_scans, match_poses
from runtime.sensors.range_image import RangeImage

SAMPLES = 12  # scans whose points are looked at, spread over the sequence


def diagnose(
    folder: str | Path,
    sensor: RangeImage | None = None,
    poses: str | Path | None = None,
    calib: str | Path | None = None,
    frame: str | None = None,
) -> list[Finding]:
    """Findings about the sequence in `folder`, best read in their order; pose files as in `find_pose_files`.

    sensor: what the bundle was made for; None leaves that comparison out. Broken input becomes a finding, not
    an error.
    """
    folder = Path(folder).resolve()
    try:
        scans = list_scans(folder)
    except MosError as error:
        return [Finding("bad", "scans", str(error))]
    found = check_files(scans)
    samples = _read_samples(scans)
    if samples:
        points = Samples.of(samples)
        found += check_points(points)
        found += check_sensor(points, sensor) if sensor else []
    found += check_times(folder / "times.txt", len(scans))
    return found + _diagnose_poses(folder, scans, poses, calib, frame)


def _read_samples(scans: tuple[Path, ...]) -> list[Scan]:
    """Some readable scans, spread over the sequence."""
    found = []
    for i in np.unique(np.linspace(0, len(scans) - 1, SAMPLES).round().astype(int)):
        try:
            found.append(read_scan(scans[i]))
        except ScanError:  # check_files has said so
            continue
    return found


def _diagnose_poses(
    folder: Path,
    scans: tuple[Path, ...],
    poses: str | Path | None,
    calib: str | Path | None,
    frame: str | None,
) -> list[Finding]:
    found: list[Finding] = []
    try:
        files = find_pose_files(folder, poses, calib, frame)
        raw = read_poses(files.poses)
        found += check_rigid(raw, files.poses)
        every = files.read()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", MosWarning)
            lines = match_poses(scans, len(raw), files.poses)
        found += [Finding("warn", "poses", str(warning.message)) for warning in caught]
    except MosError as error:
        return [*found, Finding("bad", "poses", str(error))]
    if any(finding.level == "bad" for finding in found):
        return found
    others = other_readings(folder, files, raw[lines])
    return found + check_steps(every[lines]) + check_alignment(scans, every[lines], others)

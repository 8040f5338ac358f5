"""The main job: a prediction file for every scan of a sequence. Interrupted, it goes on where it was."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from runtime import __version__
from runtime.bundle.loading import sha256_of
from runtime.bundle.manifest import MANIFEST
from runtime.errors import MosError, OutputError, SettingError
from runtime.files import write_whole
from runtime.recordings.labels import LABEL_BYTES, write_labels
from runtime.recordings.poses import Pose
from runtime.recordings.scans import Scan, count_points
from runtime.recordings.sequence import Sequence
from runtime.runner import MosRunner


@dataclass
class Summary:
    """What a run did. Latencies in seconds, one a scan."""

    folder: Path  # where the predictions are
    resumed: int = 0  # scans whose predictions were there already
    scans: int = 0
    points: int = 0
    moving: int = 0
    latency: dict[str, list[float]] = field(default_factory=dict)  # "read", the runner's stages, "write", "scan": all

    def add(self, points: int, moving: int, seconds: dict[str, float]) -> None:
        self.scans += 1
        self.points += points
        self.moving += moving
        for stage, value in seconds.items():
            self.latency.setdefault(stage, []).append(value)


def prediction_path(out: str | Path, sequence: Sequence, index: int) -> Path:
    """`out/sequences/NAME/predictions/SCAN.label`, SemanticKITTI's layout."""
    return _folder(out, sequence) / f"{sequence.scans[index].stem}.label"


def predict(
    sequence: Sequence,
    runner: MosRunner,
    out: str | Path,
    *,
    overwrite: bool = False,
    on_progress: Callable[[int, int], object] = lambda done, total: None,
) -> Summary:
    """Write the labels of every scan of `sequence` under `out`; 251 moving, 9 everything else.

    Goes on after the complete predictions that an interrupted run left, to the same bytes: the runner's
    history is refilled from the scans before. `on_progress(done, total)` is called at the start and after
    every scan.

    Raises SettingError where `out` holds predictions of other settings (then `overwrite` deletes them first),
    and the ScanError, PoseError, InferenceError or OutputError of a scan that fails, saying which; what was
    finished stays.
    """
    folder = _folder(out, sequence)
    _claim(folder, _identity(sequence, runner), overwrite)
    done, total = _count_done(sequence, out), len(sequence)
    summary = Summary(folder, resumed=done)
    on_progress(done, total)
    runner.reset()
    for index in range(max(0, done - runner.history_length), total):
        try:
            if index < done:
                runner.remember(*_read(sequence, index, runner))
            else:
                summary.add(*_label(sequence, index, runner, out))
        except MosError as error:
            raise type(error)(
                f"stopped at scan {sequence.scans[index].name} ({index + 1} of {total}): {error}. The "
                f"predictions before it are complete in {folder}; the same command goes on from there"
            ) from error
        on_progress(max(done, index + 1), total)
    return summary


def _label(sequence: Sequence, index: int, runner: MosRunner, out: str | Path) -> tuple[int, int, dict[str, float]]:
    """Read, run and write one scan: its points, how many of them move, and seconds of each stage."""
    started = time.perf_counter()
    scan, pose = _read(sequence, index, runner)
    read = time.perf_counter()
    result = runner(scan, pose)
    ran = time.perf_counter()
    write_labels(prediction_path(out, sequence, index), result.moving)
    written = time.perf_counter()
    stages = {stage: seconds for stage, seconds in result.timing.items() if stage != "total"}
    stages = {"read": read - started, **stages, "write": written - ran, "scan": written - started}
    return len(scan), int(np.count_nonzero(result.moving)), stages


def _read(sequence: Sequence, index: int, runner: MosRunner) -> tuple[Scan, Pose]:
    """A scan without remission gets the mean that the network subtracts."""
    return sequence.read(index, remission_fill=runner.bundle.manifest.sensor.range_image.mean[4])


def _folder(out: str | Path, sequence: Sequence) -> Path:
    return Path(out) / "sequences" / sequence.name / "predictions"


def _identity(sequence: Sequence, runner: MosRunner) -> dict[str, Any]:
    """What predictions depend on: they may be continued only by a run of the same."""
    return {
        "bundle": runner.bundle.manifest.name,
        "manifest_sha256": sha256_of(runner.bundle.path / MANIFEST),
        "postprocess": runner.postprocess,
        "refine": runner.settings.refine,
        "precision": runner.precision,
        "version": __version__,
        "first_scan": sequence.scans[0].name,
        "poses_sha256": sequence.poses_sha256,
    }


def _claim(folder: Path, identity: dict[str, Any], overwrite: bool) -> None:
    """Make `folder` the place of this run: note what its predictions are of, or check the note there."""
    note = folder.with_name("run.json")
    existing = sorted(folder.glob("*.label"))
    if overwrite:
        for file in existing:
            try:
                file.unlink()
            except OSError as error:
                raise OutputError(f"cannot delete {file}: {error.strerror}") from error
    elif existing:
        found = _read_note(note)
        if found is None:
            raise SettingError(
                f"{folder} holds predictions, but {note.name} beside it does not say of what; "
                f"choose another --out, or replace them by --overwrite"
            )
        changed = sorted(key for key in identity | found if identity.get(key) != found.get(key))
        if changed:
            raise SettingError(
                f"{folder} holds predictions of another run ({', '.join(changed)} differ, see {note}); "
                f"choose another --out, or replace them by --overwrite"
            )
        return
    write_whole(note, (json.dumps(identity, indent=2) + "\n").encode())


def _read_note(note: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(note.read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def _count_done(sequence: Sequence, out: str | Path) -> int:
    """Scans from the first on whose prediction is there and has a label for every point."""
    for index, scan in enumerate(sequence.scans):
        try:
            size = prediction_path(out, sequence, index).stat().st_size
        except FileNotFoundError:
            return index
        if size != LABEL_BYTES * count_points(scan):
            return index
    return len(sequence)

"""The main job: a prediction file for every scan of a recording. Interrupted, it goes on where it was."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from runtime import __version__
from runtime.bundle.loading import sha256_of
from runtime.bundle.manifest import MANIFEST
from runtime.errors import MosError, PoseError, ScanError
from runtime.recordings.journal import JOURNAL, Dependence, Entry, Journal
from runtime.recordings.labels import LABEL_BYTES, write_labels
from runtime.recordings.recording import Indexed, Recording, Scan
from runtime.recordings.run_note import claim, delete
from runtime.runner import MosRunner


@dataclass
class Summary:
    """What a run did. Latencies in seconds, one a scan."""

    folder: Path  # where the predictions are
    resumed: int = 0  # scans that were dealt with already
    anew: int = 0  # scans that had a label, of what they or those before them were once
    scans: int = 0
    points: int = 0
    moving: int = 0
    broken: dict[str, str] = field(default_factory=dict)  # scans without a label, and why
    latency: dict[str, list[float]] = field(default_factory=dict)  # "read", the runner's stages, "write", "scan": all

    def add(self, points: int, moving: int, seconds: dict[str, float]) -> None:
        self.scans += 1
        self.points += points
        self.moving += moving
        for stage, value in seconds.items():
            self.latency.setdefault(stage, []).append(value)


def predictions_folder(out: str | Path, recording: Recording) -> Path:
    """`out/sequences/NAME/predictions`, SemanticKITTI's layout."""
    return Path(out) / "sequences" / recording.name / "predictions"


def predict(
    recording: Recording,
    runner: MosRunner,
    out: str | Path,
    *,
    overwrite: bool = False,
    skip_broken: bool = False,
    on_progress: Callable[[int, int | None], object] = lambda done, total: None,
) -> Summary:
    """Write the labels of every scan of `recording` under `out`; 251 moving, 9 everything else.

    Every scan is read; those are left out whose label is there and made of the same (points, pose and time, of them and
    of the scans that a label depends on), so that an interrupted run goes on to the same bytes, and a repaired scan is
    labelled anew, with those that depend on it.

    skip_broken: a scan that cannot be read, or whose pose is broken, gets no label; the scans after it are labelled
    as after a gap, without those before it. Such scans are noted in run.json, and tried again in every run.
    `on_progress(done, total)` is called at the start and after every scan; total: None if it is not known.

    Raises SettingError where `out` holds predictions of other settings (then `overwrite` deletes them first),
    and the ScanError, PoseError, InferenceError or OutputError of a scan that fails, saying which; what was
    finished stays.
    """
    run = _Run(recording, runner, predictions_folder(out, recording), overwrite)
    total = len(recording) if isinstance(recording, Indexed) else None
    on_progress(0, total)
    scans = recording.scans()
    for index in count():
        try:
            if not run.one(scans):
                break
        except MosError as error:
            skip = skip_broken and isinstance(error, ScanError | PoseError)
            if not (skip and isinstance(recording, Indexed)):
                raise run.stopped(error, index, total) from error
            run.skip(recording.keys[index], str(error))
            scans = recording.scans(index + 1)
        on_progress(index + 1, total)
    run.close()
    return run.summary


class _Run:
    """A run between two scans."""

    def __init__(self, recording: Recording, runner: MosRunner, folder: Path, overwrite: bool) -> None:
        """Claim the folder, see `claim`."""
        self.recording, self.runner, self.folder = recording, runner, folder
        self.note = claim(folder, _identity(recording, runner), recording, overwrite)
        self.journal = Journal(folder.with_name(JOURNAL))
        self.summary = Summary(folder)
        self._dependence = Dependence(runner.history_length)
        self._unseen: deque[Scan] = deque(maxlen=runner.history_length)  # the last, where the runner does not know them
        runner.reset()

    def one(self, scans: Iterator[Scan]) -> bool:
        """Read the next scan and label it, unless its label is there; False where there is none any more."""
        started = time.perf_counter()
        scan = next(scans, None)
        if scan is None:
            return False
        made_of = self._dependence.add(self.recording.fingerprint(scan))
        path = self.folder / f"{scan.key}.label"
        size = path.stat().st_size if path.is_file() else None
        if self.journal[scan.key] == Entry(made_of) and size == LABEL_BYTES * len(scan.data):
            self._leave_out(scan)
        else:
            self.summary.anew += self.journal[scan.key].made_of not in (None, made_of)
            self._label(scan, path, made_of, started)
        return True

    def skip(self, key: str, reason: str) -> None:
        """Leave a broken scan without a label, and forget those before it."""
        self.runner.reset()
        self._unseen.clear()
        self._dependence.clear()
        self.summary.broken[key] = reason
        if self.journal[key].broken == reason:
            self.summary.resumed += 1
            return
        self.journal.take_back(key)
        delete(self.folder / f"{key}.label")
        self.journal.note(key, Entry(broken=reason))
        self.note.write(self.journal.broken())

    def stopped(self, error: MosError, index: int, total: int | None) -> MosError:
        """The error of a scan, with where it is and what is left."""
        name = self.recording.keys[index] if isinstance(self.recording, Indexed) else "number"
        return type(error)(
            f"stopped at scan {name} ({index + 1}{f' of {total}' if total else ''}): {error}. The "
            f"predictions before it are complete in {self.folder}; the same command goes on from there"
        )

    def close(self) -> None:
        """Note the scans that are broken still."""
        self.note.write(self.journal.broken())

    def _leave_out(self, scan: Scan) -> None:
        if len(self._unseen) == self._unseen.maxlen:  # what the runner has is too old: to it, the poses would jump
            self.runner.reset()
        self._unseen.append(scan)
        self.summary.resumed += 1

    def _label(self, scan: Scan, path: Path, made_of: str, started: float) -> None:
        """Run and write one scan that was read since `started`, and note seconds of each stage."""
        read = time.perf_counter()
        while self._unseen:
            past = self._unseen.popleft()
            self.runner.remember(past.data, past.known_pose(), past.time)
        begun = time.perf_counter()
        result = self.runner(scan.data, scan.known_pose(), scan.time)
        ran = time.perf_counter()
        self.journal.take_back(scan.key)
        write_labels(path, result.moving)
        self.journal.note(scan.key, Entry(made_of))
        written = time.perf_counter()
        stages = {stage: seconds for stage, seconds in result.timing.items() if stage != "total"}
        whole = read - started + written - begun
        stages = {"read": read - started, **stages, "write": written - ran, "scan": whole}
        self.summary.add(len(scan.data), int(np.count_nonzero(result.moving)), stages)


def _identity(recording: Recording, runner: MosRunner) -> dict[str, Any]:
    """What was chosen for these predictions: they may be continued only by a run of the same."""
    return {
        "bundle": runner.bundle.manifest.name,
        "manifest_sha256": sha256_of(runner.bundle.path / MANIFEST),
        "postprocess": runner.postprocess,
        "refine": runner.settings.refine,
        "precision": runner.precision,
        "belief": runner.settings.belief,
        "version": __version__,
        "poses": recording.poses_from,
    }

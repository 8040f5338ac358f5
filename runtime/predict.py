"""The main job: a prediction file for every scan of a recording. Interrupted, it goes on where it was."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from runtime import __version__
from runtime.belief.result import MosResult
from runtime.bundle.loading import sha256_of
from runtime.bundle.manifest import MANIFEST
from runtime.errors import MosError, PoseError, ScanError
from runtime.files import delete, locked
from runtime.recordings.journal import JOURNAL, Dependence, Entry, Journal, piece_journal
from runtime.recordings.labels import LABEL_BYTES, write_labels
from runtime.recordings.poses import check_pose
from runtime.recordings.read_ahead import read_ahead
from runtime.recordings.recording import Indexed, Recording, Scan
from runtime.recordings.run_note import RunNote, check_own, claim, settled_at
from runtime.runner import MosRunner
from runtime.sensors.registry import told_apart


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


class Output(Protocol):
    """Something that is written of each scan beside its label."""

    def path(self, key: str) -> Path:
        """The file of a scan."""
        ...

    def write(self, scan: Scan, result: MosResult) -> None:
        """Raises OutputError."""
        ...


def predictions_folder(out: str | Path, name: str) -> Path:
    """`out/sequences/NAME/predictions`, SemanticKITTI's layout."""
    return Path(out) / "sequences" / name / "predictions"


def predict(
    recording: Recording,
    runner: MosRunner,
    out: str | Path,
    *,
    overwrite: bool = False,
    skip_broken: bool = False,
    outputs: Sequence[Output] = (),
    piece: range | None = None,
    on_progress: Callable[[int, int | None], object] = lambda done, total: None,
) -> Summary:
    """Write the labels of every scan of `recording` under `out`; 251 moving, 9 everything else.

    Every scan is read; those are left out whose label is there and made of the same (points, pose and time, of them and
    of the scans that a label depends on), so that an interrupted run goes on to the same bytes, and a repaired scan is
    labelled anew, with those that depend on it.

    skip_broken: a scan that cannot be read, or whose pose is broken, gets no label; the scans after it are labelled
    as after a gap, without those before it. Such scans are noted in run.json, and tried again in every run.
    outputs: what else is written of each scan; where that is missing, the scan is labelled anew.
    piece: only scans of these numbers get labels, the same ones as in a run over all: those that they depend on are
    read before them (and after them, with a delay). `runtime.fleet.dividing` says what comes before and after pieces.
    `on_progress(done, total)` is called at the start and after every scan; total: None if it is not known.

    Raises SettingError where `out` holds predictions of other settings (then `overwrite` deletes them first),
    OutputError where another run writes there just now, and the ScanError, PoseError, InferenceError or OutputError of
    a scan that fails, saying which; what was finished stays.
    """
    with locked(predictions_folder(out, recording.name).parent, shared=piece is not None):
        run = _Run(recording, runner, out, outputs, piece)
        run.begin(overwrite)
        total = len(recording) if isinstance(recording, Indexed) else None
        begin, end = (0, total) if piece is None else (piece.start, len(piece))
        on_progress(0, end)
        scans = read_ahead(recording.scans(run.next))
        try:
            for index in count(run.next):
                try:
                    if not run.one(scans):
                        break
                except MosError as error:
                    skip = skip_broken and isinstance(error, ScanError | PoseError)
                    if not (skip and isinstance(recording, Indexed)):
                        raise run.stopped(error, index, total) from error
                    run.skip(index, recording.keys[index], str(error))
                    scans.close()
                    scans = read_ahead(recording.scans(index + 1))
                if index >= begin:
                    on_progress(min(index + 1 - begin, end or index + 1), end)
        finally:
            scans.close()
        run.close()
        return run.summary


@dataclass
class _Read:
    """A scan whose label has not been dealt with."""

    number: int
    scan: Scan
    seconds: float  # that were spent on waiting for it
    known: bool = False  # to the runner, by a call
    result: MosResult | None = None


class _Run:
    """A run between two scans."""

    def __init__(
        self, recording: Recording, runner: MosRunner, out: str | Path, outputs: Sequence[Output], piece: range | None
    ) -> None:
        self.recording, self.runner, self.outputs = recording, runner, outputs
        self.folder = predictions_folder(out, recording.name)
        self.summary, self.next = Summary(self.folder), 0  # number of the scan that is read next
        self.note: RunNote | None = None
        self._piece = piece
        self._delay: int = runner.settings.delay
        self._dependence = Dependence(runner.history_length + self._delay)
        self._ahead: deque[_Read] = deque()  # read, but their labels depend on scans that are not
        self._unseen: deque[Scan] = deque(maxlen=runner.history_length)  # the last, where the runner does not know them
        self._given: deque[_Read] = deque()  # to the runner, which has not given their results yet
        runner.reset()

    def begin(self, overwrite: bool) -> None:
        """Claim the folder, see `claim`; of a piece: go to the first scan that it depends on."""
        whole, chosen = self.folder.with_name(JOURNAL), identity(self.recording, self.runner)
        if self._piece is None:
            self.note = claim(self.folder, chosen, self.recording, overwrite)
            self.journal = Journal(whole)
            return
        check_own(self.folder, chosen)
        settled = settled_at(self.folder)
        self.journal = Journal(piece_journal(whole, self._piece), whole)
        self.next = max(0, self._piece.start - self.runner.history_length)
        if settled.shown_by is not None and settled.shown_by < self.next:
            shown = next(self.recording.scans(settled.shown_by))
            self.runner.choose_sensor(shown.data, shown.ring)

    def one(self, scans: Iterator[Scan]) -> bool:
        """Read the next scan, and label that which it completes unless its label is there; False at the end."""
        if self._piece and self.next == self._piece.stop + self._delay:
            return False
        started = time.perf_counter()
        scan = next(scans, None)
        if scan is None:
            self.finish()
            return False
        check_pose(scan.known_pose(), "pose")  # before other scans come to depend on it
        self.runner.choose_sensor(scan.data, scan.ring)  # the first of the recording, not the first that is labelled
        made_of = self._dependence.add(self.recording.fingerprint(scan))
        self._ahead.append(_Read(self.next, scan, time.perf_counter() - started))
        self.next += 1
        if len(self._ahead) > self._delay:
            self._deal_with(made_of)
        return True

    def finish(self) -> None:
        """Nothing follows the scans that were read: label those that wait for what does."""
        while self._ahead:
            self._deal_with(self._dependence.add(""))

    def skip(self, number: int, key: str, reason: str) -> None:
        """Leave a broken scan without a label, and forget those before it."""
        self.finish()
        self._forget()
        self._unseen.clear()
        self._dependence.clear()
        self.next = number + 1
        if not self._is_wanted(number):
            return
        self.summary.broken[key] = reason
        if self.journal[key].broken == reason:
            self.summary.resumed += 1
            return
        self.journal.take_back(key)
        delete(self.folder / f"{key}.label")
        self.journal.note(key, Entry(broken=reason))
        self.close()

    def stopped(self, error: MosError, index: int, total: int | None) -> MosError:
        """The error of a scan, with where it is and what is left."""
        name = self.recording.keys[index] if isinstance(self.recording, Indexed) else "number"
        waiting = f", but for {len(self._ahead)} that wait for later scans," if self._delay else ""
        before = f"from number {self._piece.start + 1} to it" if self._piece else "before it"
        return type(error)(
            f"stopped at scan {name} ({index + 1}{f' of {total}' if total else ''}): {error}. The "
            f"predictions {before} are complete{waiting} in {self.folder}; the same command goes on from there"
        )

    def close(self) -> None:
        """Note the scans that are broken still."""
        if self.note:
            self.note.write(self.journal.broken())

    def _is_wanted(self, number: int) -> bool:
        return self._piece is None or number in self._piece

    def _deal_with(self, made_of: str) -> None:
        """Label the first of the scans ahead unless its label is there, made of the same."""
        read = self._ahead[0]
        key = read.scan.key
        path = self.folder / f"{key}.label"
        size = path.stat().st_size if path.is_file() else None
        whole = size == LABEL_BYTES * len(read.scan.data) and all(one.path(key).is_file() for one in self.outputs)
        if not self._is_wanted(read.number):
            pass  # others depend on it
        elif self.journal[key] == Entry(made_of) and whole:
            self.summary.resumed += 1
        else:
            self.summary.anew += self.journal[key].made_of not in (None, made_of)
            self._label(read, path, made_of)
        self._ahead.popleft()
        if not read.known:
            if len(self._unseen) == self._unseen.maxlen:  # what the runner has is too old: to it, the poses would jump
                self._forget()
            self._unseen.append(read.scan)

    def _label(self, read: "_Read", path: Path, made_of: str) -> None:
        """Run and write one scan, and note seconds of each stage."""
        while self._unseen:
            past = self._unseen.popleft()
            self.runner.remember(past)
        begun = time.perf_counter()
        result = self._result(read)
        ran = time.perf_counter()
        self.journal.take_back(read.scan.key)
        for one in self.outputs:
            one.write(read.scan, result)
        write_labels(path, result.moving)
        self.journal.note(read.scan.key, Entry(made_of))
        written = time.perf_counter()
        stages = {stage: seconds for stage, seconds in result.timing.items() if stage != "total"}
        whole = read.seconds + written - begun
        stages = {"read": read.seconds, **stages, "write": written - ran, "scan": whole}
        self.summary.add(len(read.scan.data), int(np.count_nonzero(result.moving)), stages)

    def _result(self, read: "_Read") -> MosResult:
        """The result of the first of the scans ahead, once the runner has seen all of them."""
        for one in self._ahead:
            if not one.known:
                result = self.runner(one.scan)
                one.known = True
                self._given.append(one)
                self._take([result] if result else [])
        if read.result is None:  # nothing follows
            self._take(self.runner.flush())
        assert read.result is not None
        return read.result

    def _take(self, results: list[MosResult]) -> None:
        """Results come in the order of the scans."""
        for result in results:
            self._given.popleft().result = result

    def _forget(self) -> None:
        """The next scan is the first of a sequence to the runner."""
        self.runner.reset(keep_sensor=True)
        self._given.clear()


def identity(recording: Recording, runner: MosRunner) -> dict[str, Any]:
    """What was chosen for these predictions: they may be continued only by a run of the same."""
    return {
        "bundle": runner.bundle.manifest.name,
        "manifest_sha256": sha256_of(runner.bundle.path / MANIFEST),
        "sensor": runner.settings.profile and told_apart(runner.settings.profile),
        **{name: getattr(runner.settings, name) for name in ("nearest", "body", "refine", "delay")},
        **{name: getattr(runner, name) for name in ("postprocess", "precision", "belief")},
        "version": __version__,
        "poses": recording.poses_from,
    }

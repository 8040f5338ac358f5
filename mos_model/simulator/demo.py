"""`mos demo`: the main job where there is nothing yet: a simulated street, its movers found, the result shown."""

import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.bundle.residual import HISTORY
from runtime.classes import MOVING, to_classes
from runtime.compute.compiling import compiling
from runtime.errors import MissingPackageError, OutputError
from runtime.evaluation.confusion import Confusion
from runtime.evaluation.evaluate import evaluate
from runtime.evaluation.layout import pair
from runtime.files import write_whole
from runtime.pictures import Stored, System, snapshots, write_picture
from runtime.predict import Summary, predict
from runtime.recordings.recording import Indexed
from runtime.recordings.registry import open_recording
from runtime.runner import MosRunner

SEED = 17  # of the street
STREET: dict[str, Any] = {"street": "urban", "ego": "cruise", "movers": 1.0}
SCANS = 30

NOTE = "demo.json"  # marks the folder of a demo

SIMULATE, PREPARE, LABEL, DRAW = "simulate a street", "load the network", "find what moves", "draw pictures"
Report = Callable[[str, int, int, str], object]  # stage, steps done, steps in all, what is being compiled or ""


@dataclass(frozen=True)
class Demo:
    """What a demo did."""

    sequence: Path  # the simulated street
    summary: Summary  # scans, points and latencies
    scores: Confusion  # of all scans, as `mos eval` counts
    pictures: tuple[Path, ...]
    no_pictures: str  # why there are none, or nothing
    seconds: float  # from the first to the last of it, compiling included


def run_demo(
    out: str | Path,
    scans: int = SCANS,
    bundle: str | Path | None = None,
    threads: int = 2,
    report: Report = lambda stage, done, total, kernel: None,
) -> Demo:
    """Simulate a street of `scans` scans into `out`/street (or take the one that is there), label it, draw it.

    Raises OutputError where `out` cannot be written or holds anything but such a demo, and what `MosRunner` and
    `predict` raise.
    """
    started = time.perf_counter()
    out = Path(out)
    folder = out / "street" / "sequences" / "00"
    _claim(out, scans)
    recording = _simulate(folder, scans, report)
    with compiling(lambda kernel: report(PREPARE, 0, 1, kernel)):
        report(PREPARE, 0, 1, "")
        runner = MosRunner(bundle, threads=threads)
        report(PREPARE, 1, 1, "")
    predictions = out / "predictions"
    summary = predict(
        recording,
        runner,
        predictions,
        overwrite=True,
        on_progress=lambda done, total: report(LABEL, done, total or done, ""),
    )
    (counts,) = evaluate(pair(predictions, folder.parents[1]).frames, with_ranges=False).values()
    pictures, why_not = _draw(out, recording, Stored(predictions, recording, runner.bundle.manifest.name), report)
    return Demo(folder, summary, counts.total(), pictures, why_not, time.perf_counter() - started)


def _claim(out: Path, scans: int) -> None:
    """Note what the folder is for: nothing of anybody else's is ever overwritten."""
    note = out / NOTE
    content = json.dumps({"demo": "lidar-mos", "scans": scans, "seed": SEED, **STREET}, indent=2).encode() + b"\n"
    try:
        theirs = note.read_bytes() != content if note.exists() else out.exists() and any(out.iterdir())
    except OSError as error:
        raise OutputError(f"{out}: cannot be read ({error.strerror}); name another folder (`out`)") from error
    if theirs:
        raise OutputError(f"{out}: holds something else, or a demo of other settings; name a new folder (`out`)")
    write_whole(note, content)


def _simulate(folder: Path, scans: int, report: Report) -> Indexed:
    """The sequence in `folder`, made if it is not there (it is whole or absent)."""
    if not folder.is_dir():
        from mos_model.simulator import write_dataset

        with compiling(lambda kernel: report(SIMULATE, 0, scans, kernel)):
            report(SIMULATE, 0, scans, "")
            write_dataset(
                folder.parents[1],
                frames=scans,
                seed=SEED,
                progress=lambda done, total: report(SIMULATE, done, total, ""),
                **STREET,
            )
    return open_recording(folder)


def _busiest(recording: Indexed, scans: Iterable[int]) -> int:
    """The scan with the most moving points."""

    def movers(scan: int) -> int:
        labels = recording.labels(scan)
        return 0 if labels is None else int((to_classes(labels) == MOVING).sum())

    return max(scans, key=movers)


def _draw(out: Path, recording: Indexed, system: System, report: Report) -> tuple[tuple[Path, ...], str]:
    """Pictures of the busiest scan and of all, of those with a full history; or none, and why."""
    ready = range(min(HISTORY, len(recording) - 1), len(recording))
    drawn = (out / "scan.png", [_busiest(recording, ready)]), (out / "street.gif", ready)
    total, done = sum(len(scans) for _, scans in drawn), 0

    def counted(scans: Iterable[int]) -> Iterator[int]:
        nonlocal done
        for scan in scans:
            report(DRAW, done, total, "")
            yield scan
            done += 1

    try:
        for path, scans in drawn:
            write_picture(path, snapshots(recording, [system], counted(scans)))
    except MissingPackageError as error:
        return (), str(error)
    report(DRAW, total, total, "")
    return tuple(path for path, _ in drawn), ""

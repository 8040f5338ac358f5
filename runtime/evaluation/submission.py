"""The archive that the benchmark's server takes, checked as the server does and a little more strictly."""

import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from runtime.classes import MOVING, RANGE, to_classes
from runtime.errors import MosWarning, SequenceError, SettingError, raise_all, some
from runtime.evaluation.layout import by_stem, find_labels
from runtime.files import replacing
from runtime.recordings.labels import LABEL_BYTES, Labels, read_prediction
from runtime.recordings.recording import Indexed, Options
from runtime.recordings.registry import open_recordings

TEST_SCANS = {  # of the sequences without public labels, as KITTI odometry has them
    "11": 921,
    "12": 1061,
    "13": 3281,
    "14": 631,
    "15": 1901,
    "16": 1731,
    "17": 491,
    "18": 1801,
    "19": 4981,
    "20": 831,
    "21": 2721,
}
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every entry, so that the same predictions give the same archive
SO = "nothing was packed"


@dataclass(frozen=True)
class Submission:
    """What to pack. checked: what the number and length of the predictions agree with."""

    files: dict[str, tuple[Path, ...]]  # by sequence, in order of their names
    checked: str


def check(predictions: str | Path, truth: str | Path | None = None, names: tuple[str, ...] = ()) -> Submission:
    """Predictions of the sequences 11 to 21, which the benchmark wants, or of `names`, every scan present.

    truth: root of the data set; every scan of it must have a prediction with a label for each point. Without `truth` or
    `names`, the file names must count on from 000000, in the benchmark's sequences to their last scan.
    Raises SequenceError naming every file that is missing, too much or of the wrong length.
    """
    folders = _pick(predictions, names)
    wanted = _scans(truth, tuple(folders)) if truth is not None else {}
    problems: list[str] = []
    for name, folder in folders.items():
        if name in wanted:
            problems += _sizes(folder, wanted[name])
        if name not in wanted or not names:
            problems += _numbers(folder, TEST_SCANS.get(name))
    raise_all(list(dict.fromkeys(problems)), SO)
    checked = (
        f"number and length agree with the scans of {truth}"
        if truth is not None
        else "the file names count on without a gap, in 11 to 21 to the last scan (not checked: lengths; give TRUTH)"
    )
    return Submission({name: tuple(by_stem(folder).values()) for name, folder in folders.items()}, checked)


def pack(
    submission: Submission, out: str | Path, on_progress: Callable[[int, int], object] = lambda done, total: None
) -> None:
    """Write the archive `out` of sequences/NN/predictions/*.label, whole or not at all.

    `on_progress(done, total)` is called after each file. Raises SettingError for a name that is not .zip,
    SequenceError naming files that do not hold labels, OutputError where `out` cannot be written. Warns (MosWarning) of
    sequences in which nothing moves.
    """
    out = Path(out)
    if out.suffix != ".zip":
        raise SettingError(f"{out}: the server takes only files whose name ends with .zip")
    total, done = sum(map(len, submission.files.values())), 0
    moving = dict.fromkeys(submission.files, 0)  # points, by sequence
    problems: list[str] = []
    with replacing(out) as file, zipfile.ZipFile(file, "w") as archive:
        _folder(archive, "sequences/")
        for name, files in submission.files.items():
            _folder(archive, f"sequences/{name}/")
            _folder(archive, f"sequences/{name}/predictions/")  # the server looks for entries of folders
            for path in files:
                labels = _read(path, problems)
                moving[name] += int((to_classes(labels) == MOVING).sum())
                if not problems:  # else only the other problems are of interest
                    _add(archive, f"sequences/{name}/predictions/{path.name}", labels)
                done += 1
                on_progress(done, total)
        raise_all(problems, SO)
    if still := [name for name, points in moving.items() if not points]:
        where = "any sequence" if len(still) == len(moving) else f"sequence {some(still)}"
        warnings.warn(f"{out}: no point of {where} is labelled as moving ({RANGE})", MosWarning, stacklevel=2)


def _pick(predictions: str | Path, names: tuple[str, ...]) -> dict[str, Path]:
    """Folders of predictions of `names`, or of all sequences of the benchmark's hidden part."""
    if names:
        return find_labels(predictions, "predictions", names)
    found = find_labels(predictions, "predictions")
    if missing := [name for name in TEST_SCANS if name not in found]:
        raise SequenceError(
            f"{predictions}: has no predictions of sequence {', '.join(missing)}; the server wants all of 11 to 21 "
            f"(there are {some(list(found))}; to pack others than the benchmark's, name them (`names`))"
        )
    return {name: found[name] for name in TEST_SCANS}


def _scans(truth: str | Path, names: tuple[str, ...]) -> dict[str, Indexed]:
    """The recording of each sequence."""
    recordings = open_recordings(truth, options=Options(points_only=True))
    if len(recordings) == len(names) == 1:
        return {names[0]: recordings[0]}
    by_name = {one.name: one for one in recordings}
    raise_all([f"sequence {name}: no scans under {truth}" for name in names if name not in by_name], SO)
    return {name: by_name[name] for name in names}


def _sizes(folder: Path, scans: Indexed) -> list[str]:
    """Problems of the files in `folder`, of which every scan needs one with a label for each point."""
    labels = by_stem(folder)
    problems = [f"{folder / stem}.label: missing" for stem in scans.keys if stem not in labels]
    problems += [f"{labels[stem]}: there is no scan of this name" for stem in labels.keys() - set(scans.keys)]
    for index, stem in enumerate(scans.keys):
        if stem not in labels:
            continue
        points, size = scans.count(index), labels[stem].stat().st_size
        if size != LABEL_BYTES * points:
            problems.append(f"{labels[stem]}: {size} bytes are not the {LABEL_BYTES}-byte labels of {points} points")
    return sorted(problems)


def _numbers(folder: Path, scans: int | None) -> list[str]:
    """Problems of the files in `folder` that show without the scans: gaps, and too few or too many."""
    labels = by_stem(folder)
    if not labels:
        return [f"{folder}: holds no .label files"]
    stems = [f"{index:06d}" for index in range(scans or len(labels))]
    problems = [f"{folder / stem}.label: missing" for stem in stems if stem not in labels]
    return problems + [f"{labels[stem]}: there is no scan of this name" for stem in sorted(labels.keys() - set(stems))]


def _read(file: Path, problems: list[str]) -> Labels:
    """The labels in a file; what is wrong with it joins `problems`."""
    try:
        return read_prediction(file)
    except SequenceError as error:
        problems.append(str(error))
        return np.empty(0, np.uint32)


def _add(archive: zipfile.ZipFile, name: str, labels: Labels) -> None:
    entry = zipfile.ZipInfo(name, EPOCH)
    entry.external_attr = 0o644 << 16
    archive.writestr(entry, labels.astype("<u4").tobytes(), zipfile.ZIP_DEFLATED, compresslevel=1)


def _folder(archive: zipfile.ZipFile, name: str) -> None:
    entry = zipfile.ZipInfo(name, EPOCH)
    entry.external_attr = 0o40755 << 16
    archive.writestr(entry, b"")

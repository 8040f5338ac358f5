"""Which prediction belongs to which truth and which scan."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from runtime.errors import SequenceError, raise_all, some
from runtime.recordings.recording import Indexed, Options
from runtime.recordings.registry import as_given, find_recordings


@dataclass(frozen=True)
class Frame:
    """One scan to score."""

    sequence: str
    prediction: Path
    truth: Path
    scan: tuple[Indexed, int] | None  # which scan of which recording; None: the data set has none


@dataclass(frozen=True)
class Frames:
    """Everything to score, and what is left out of it."""

    predictions: Path
    truth: Path
    frames: tuple[Frame, ...]
    notes: tuple[str, ...]


def find_labels(path: str | Path, inner: str, names: tuple[str, ...] = ()) -> dict[str, Path]:
    """Folders of .label files by sequence: `path/sequences/NN/inner`, `path/NN/inner`, `path/inner` or `path` itself.

    inner: "predictions" or "labels". names: pick these sequences. Raises SequenceError where there is none.
    """
    path = as_given(Path(path))
    if not path.is_dir():
        raise SequenceError(
            f"{path}: is no folder; give a root with sequences/NN/{inner} or the folder of one sequence"
        )
    if (path / inner).is_dir():
        found = {path.name: path / inner}
    elif any(path.glob("*.label")):
        found = {path.parent.name if path.name == inner else path.name: path}
    else:
        root = path / "sequences" if (path / "sequences").is_dir() else path
        found = {folder.name: folder / inner for folder in sorted(root.iterdir()) if (folder / inner).is_dir()}
    if not found:
        raise SequenceError(f"{path}: holds neither sequences/NN/{inner} nor {inner} nor .label files")
    if missing := [name for name in names if name not in found]:
        raise SequenceError(f"{path}: has no {inner} of sequence {', '.join(missing)}; there are {some(list(found))}")
    return {name: found[name] for name in names} if names else found


def pair(predictions: str | Path, truth: str | Path, names: tuple[str, ...] = ()) -> Frames:
    """Every scan that has labels under `truth`, with its prediction; of the sequences that are predicted.

    Raises SequenceError naming each sequence without labels and each scan without a prediction.
    """
    guessed, true = find_labels(predictions, "predictions", names), find_labels(truth, "labels")
    if len(guessed) == len(true) == 1 and not names:  # two folders of one sequence may be called as they like
        guessed = dict(zip(true, guessed.values(), strict=True))
    problems = [
        f"sequence {name}: no labels of it under {truth}; pick others (`names`)" for name in guessed if name not in true
    ]
    frames: list[Frame] = []
    notes = []
    for name in sorted(guessed.keys() & true.keys()):
        made, known = by_stem(guessed[name]), by_stem(true[name])
        if not known:
            problems.append(f"{true[name]}: holds no .label files")
        absent = [f"{guessed[name] / file.name}: missing" for stem, file in known.items() if stem not in made]
        if absent:
            absent[0] += f" (1 of {len(absent)}; let the tool finish the sequence first)"
        problems += absent
        if extra := made.keys() - known.keys():
            notes.append(f"sequence {name}: {len(extra)} predictions of scans without labels are left out")
        scans = scans_of(true[name])
        frames += [Frame(name, made[s], known[s], scans.get(s)) for s in known if s in made]
    if rest := sorted(true.keys() - guessed.keys()):
        notes.append(f"no predictions of sequence {some(rest)}: not scored")
    raise_all(problems, "nothing was scored")
    return Frames(Path(predictions), Path(truth), tuple(frames), tuple(notes))


def scans_of(labels: Path) -> Mapping[str, tuple[Indexed, int]]:
    """Scans of the recording beside a folder of labels, or in it, by their keys; empty where there is none."""
    for folder in (labels.parent, labels):
        try:
            found = [one for one in find_recordings(folder) if one.path == as_given(folder)]
        except SequenceError:  # nothing there that is a recording
            continue
        if found:
            recording = found[0].open(Options(points_only=True))
            return {key: (recording, index) for index, key in enumerate(recording.keys)}
    return {}


def by_stem(folder: Path) -> dict[str, Path]:
    """The .label files of a folder, sorted, by name without suffix."""
    return {file.stem: file for file in sorted(folder.glob("*.label")) if not file.name.startswith(".")}

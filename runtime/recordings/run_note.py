"""`run.json` beside the labels of a recording: what they were made with, and which scans have none."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from runtime.errors import MosError, OutputError, SettingError
from runtime.files import delete, sweep, write_whole
from runtime.recordings.journal import JOURNAL, Dependence, Entry, Journal, join_pieces
from runtime.recordings.recording import Recording
from runtime.typed_json import build, read_json

NOTE = "run.json"
ADVICE = "choose another place (`out`), or replace them (`overwrite`)"


@dataclass(frozen=True)
class Settled:
    """What is found once in a recording, and holds for all pieces of it."""

    sensor: str | None  # for which it is labelled; None: no scan shows it
    shown_by: int | None = None  # number of the scan that shows the sensor; None: it is given, or none does
    remission_scale: float | None = None  # by which remission is divided; None: the recording does not say
    misfits: tuple[str, ...] = ()  # topics on which it was said that labels will be wrong


@dataclass
class RunNote:
    """The file, as it is to be."""

    path: Path
    content: dict[str, Any] = field(default_factory=dict)

    def write(self, broken: dict[str, str]) -> None:
        """broken: scans without a label, and why. Raises OutputError."""
        self.content |= {"broken": [{"scan": key, "reason": reason} for key, reason in broken.items()]}
        write_whole(self.path, (json.dumps(self.content, indent=2) + "\n").encode())


def claim(
    folder: Path, identity: dict[str, Any], recording: Recording, overwrite: bool, settled: Settled | None = None
) -> RunNote:
    """Make `folder`, which is locked, the place of labels of this recording, made with what `identity` says.

    What killed runs left is cleared away: temporary files, and journals of pieces. settled: is noted.

    Raises SettingError where it holds labels of another identity, or of another recording: with another path, and
    another first scan. overwrite: they are deleted instead. Raises OutputError.
    """
    sweep(folder.parent)
    found_once = {} if settled is None else {"settled": asdict(settled)}
    note = RunNote(folder.with_name(NOTE), identity | {"source": recording.source} | found_once)
    journal = folder.with_name(JOURNAL)
    join_pieces(journal)
    existing = sorted(folder.glob("*.label"))
    if overwrite or not existing:
        if journal.exists():  # first, since it must not speak of labels that are gone
            delete(journal)
        for file in existing:
            delete(file)
        note.write({})
        return note
    found = check_own(folder, identity)
    if found.get("source") != recording.source and not _begins_alike(recording, Journal(journal)):
        raise SettingError(f"{folder} holds predictions of another recording, {found.get('source')}; {ADVICE}")
    return note


def settled_at(folder: Path) -> Settled:
    """What `claim` noted for the pieces of a recording. Raises SettingError where that is gone."""
    return build(Settled, (_read(folder.with_name(NOTE)) or {}).get("settled"), str(folder.with_name(NOTE)))


def close_pieces(folder: Path) -> dict[str, str]:
    """Join what is noted of pieces, beside `folder`, which is locked. Scans that are broken, and why."""
    sweep(folder.parent)
    join_pieces(folder.with_name(JOURNAL))
    broken = Journal(folder.with_name(JOURNAL)).broken()
    RunNote(folder.with_name(NOTE), _read(folder.with_name(NOTE)) or {}).write(broken)
    return broken


def check_own(folder: Path, identity: dict[str, Any]) -> dict[str, Any]:
    """The note of a folder of predictions. Raises SettingError where it is of another identity."""
    found = _read(folder.with_name(NOTE))
    if found is None:
        raise SettingError(f"{folder} holds predictions, but {NOTE} beside it does not say of what; {ADVICE}")
    identity = json.loads(json.dumps(identity))  # as it reads: lists for tuples
    known = {key: value for key, value in found.items() if key not in ("source", "broken", "settled")}
    if changed := sorted(key for key in identity | known if identity.get(key) != known.get(key)):
        differ = f"{', '.join(changed)} differ, see {folder.with_name(NOTE)}"
        raise SettingError(f"{folder} holds predictions of another run ({differ}); {ADVICE}")
    return found


def _begins_alike(recording: Recording, journal: Journal) -> bool:
    """Whether the first scan is the one that was labelled."""
    try:
        first = next(recording.scans(), None)
    except MosError:  # will be said when it is its turn
        return True
    return first is None or journal[first.key] == Entry(Dependence(0).add(recording.fingerprint(first)))


def _read(note: Path) -> dict[str, Any] | None:
    try:
        found = read_json(note, OutputError)
    except OutputError:
        return None
    return found if isinstance(found, dict) else None

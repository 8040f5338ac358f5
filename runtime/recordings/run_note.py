"""`run.json` beside the labels of a recording: what they were made with, and which scans have none."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from runtime.errors import MosError, OutputError, SettingError
from runtime.files import write_whole
from runtime.recordings.journal import JOURNAL, Dependence, Entry, Journal
from runtime.recordings.recording import Recording
from runtime.typed_json import read_json

NOTE = "run.json"


@dataclass
class RunNote:
    """The file, as it is to be."""

    path: Path
    content: dict[str, Any] = field(default_factory=dict)

    def write(self, broken: dict[str, str]) -> None:
        """broken: scans without a label, and why. Raises OutputError."""
        self.content |= {"broken": [{"scan": key, "reason": reason} for key, reason in broken.items()]}
        write_whole(self.path, (json.dumps(self.content, indent=2) + "\n").encode())


def claim(folder: Path, identity: dict[str, Any], recording: Recording, overwrite: bool) -> RunNote:
    """Make `folder` the place of labels of this recording, made with what `identity` says.

    Raises SettingError where it holds labels of another identity, or of another recording: with another path, and
    another first scan. overwrite: they are deleted instead. Raises OutputError.
    """
    note = RunNote(folder.with_name(NOTE), identity | {"source": recording.source})
    journal = folder.with_name(JOURNAL)
    existing = sorted(folder.glob("*.label"))
    if overwrite or not existing:
        if journal.exists():  # first, since it must not speak of labels that are gone
            delete(journal)
        for file in existing:
            delete(file)
        note.write({})
        return note
    advice = "choose another place (`out`), or replace them (`overwrite`)"
    found = _read(note.path)
    if found is None:
        raise SettingError(f"{folder} holds predictions, but {NOTE} beside it does not say of what; {advice}")
    known = {key: value for key, value in found.items() if key not in ("source", "broken")}
    if changed := sorted(key for key in identity | known if identity.get(key) != known.get(key)):
        differ = f"{', '.join(changed)} differ, see {note.path}"
        raise SettingError(f"{folder} holds predictions of another run ({differ}); {advice}")
    if found.get("source") != recording.source and not _begins_alike(recording, Journal(journal)):
        raise SettingError(f"{folder} holds predictions of another recording, {found.get('source')}; {advice}")
    return note


def delete(file: Path) -> None:
    """Delete a file that may be there. Raises OutputError."""
    try:
        file.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot delete {file}: {error.strerror}") from error


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

"""What each label was made of, so that a scan that has changed since is labelled anew."""

import hashlib
import json
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path

from runtime.errors import OutputError
from runtime.files import delete, read_ordinary, write_whole
from runtime.typed_json import build

JOURNAL = "scans.jsonl"  # beside the folder of the labels
PIECES = "scans.*.jsonl"  # of pieces that are labelled side by side, until they are joined


@dataclass(frozen=True)
class Entry:
    """What is known of a scan that was dealt with."""

    made_of: str | None = None  # digest of it and of the scans before it that its label depends on; None: not known
    broken: str | None = None  # why it has no label


class Journal:
    """A file of one line a scan, the last one of a scan being the one that counts.

    A line is written once the label is in its place. Before a label is replaced, another takes back what the old one
    says, so that whenever a run is killed, what stands here is true of the labels that are there.
    """

    def __init__(self, path: Path, whole: Path | None = None) -> None:
        """Read what is there, leave out half a line at the end, and write it anew. Raises OutputError.

        whole: the journal of the recording, where this one is that of a piece of it, and says what is newer.
        """
        self.path = path
        own = _read(path)
        self._entries = (_read(whole) if whole else {}) | own
        _write(path, own)

    def __getitem__(self, key: str) -> Entry:
        return self._entries.get(key, Entry())

    def broken(self) -> dict[str, str]:
        """Scans without a label, and why."""
        return {key: entry.broken for key, entry in self._entries.items() if entry.broken is not None}

    def take_back(self, key: str) -> None:
        """The label of this scan is about to be replaced. Raises OutputError."""
        if self[key].made_of is not None:
            self.note(key, Entry())

    def note(self, key: str, entry: Entry) -> None:
        """The label of this scan is in its place, or it has none. Raises OutputError."""
        try:
            with self.path.open("a") as file:
                file.write(_line(key, entry))
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror}. Free the space and run again") from error
        self._entries[key] = entry


def piece_journal(whole: Path, piece: range) -> Path:
    """That of a piece, the numbers of its scans, beside the journal of the recording."""
    return whole.with_name(PIECES.replace("*", f"{piece.start:09d}-{piece.stop:09d}"))


def join_pieces(whole: Path) -> None:
    """Take what the journals of pieces say into that of the recording. Raises OutputError."""
    pieces = sorted(whole.parent.glob(PIECES))
    if pieces:
        _write(whole, {key: entry for path in (whole, *pieces) for key, entry in _read(path).items()})
    for path in pieces:
        delete(path)


def text_without(path: Path, scans: set[str]) -> bytes:
    """What a journal would be if it did not know these scans."""
    return _text({key: entry for key, entry in _read(path).items() if key not in scans})


class Dependence:
    """Digest of the last scans, one after the other: what the label of the newest depends on."""

    def __init__(self, history: int) -> None:
        """history: scans before it that a label depends on."""
        self._fingerprints: deque[str] = deque(maxlen=history + 1)

    def add(self, fingerprint: str) -> str:
        """The digest of the scan with this fingerprint and of those before it."""
        self._fingerprints.append(fingerprint)
        return hashlib.blake2b("\n".join(self._fingerprints).encode(), digest_size=8).hexdigest()

    def clear(self) -> None:
        """What comes next depends on nothing before it."""
        self._fingerprints.clear()


def _line(key: str, entry: Entry) -> str:
    known = {name: value for name, value in asdict(entry).items() if value is not None}
    return json.dumps({"scan": key, **known}) + "\n"


def _write(path: Path, entries: dict[str, Entry]) -> None:
    write_whole(path, _text(entries))


def _text(entries: dict[str, Entry]) -> bytes:
    return "".join(_line(key, entry) for key, entry in entries.items()).encode()


def _read(path: Path) -> dict[str, Entry]:
    entries = {}
    try:
        lines = read_ordinary(path).decode().split("\n") if path.exists() else []
    except (OSError, UnicodeDecodeError) as error:
        raise OutputError(f"{path}: cannot be read: {error}") from error
    for line in lines[:-1]:
        try:
            found = json.loads(line)
            key = str(found.pop("scan"))
            entries[key] = build(Entry, found, key)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):  # cut off in a crash, and written on:
            continue  # its scan is made anew
    return entries

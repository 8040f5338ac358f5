"""Recordings of many places: of paths, of folders with all that is below them, of patterns as shells have them."""

from collections.abc import Iterable, Iterator, Mapping
from glob import glob, has_magic
from pathlib import Path
from typing import TypeVar

from runtime.errors import SequenceError, some
from runtime.recordings.journal import JOURNAL
from runtime.recordings.registry import READERS, as_given, check_names
from runtime.recordings.run_note import NOTE

T = TypeVar("T")


def name_of(path: Path) -> str:
    """The name that the recording at a path will have."""
    return path.stem if path.is_file() else path.name


def search_recordings(given: Iterable[Path], names: tuple[str, ...] = ()) -> list[Path]:
    """Where recordings are: at each of these paths or anywhere below; `names` picks some. Each place counts once.

    What is given and holds none is in the list too, since opening it says why. Folders in which `mos` wrote labels are
    not searched. Raises SequenceError where a path does not exist, a pattern has no match, there is no recording of a
    name, or two have one name.
    """
    found = {one: name_of(one) for path in given for place in _expanded(path) for one in _at(place)}
    return choose_of(found, names, some(list(map(str, given))))


def choose_of(found: Mapping[T, str], names: tuple[str, ...], given: str) -> list[T]:
    """Of places, each with the name of its recording, those of some names, or all. Raises as `search_recordings`."""
    known = set(found.values())
    if missing := [name for name in names if name not in known]:
        raise SequenceError(f"{given}: no sequence {', '.join(missing)}; there are {some(sorted(known), most=30)}")
    chosen = [place for name in dict.fromkeys(names) for place in found if found[place] == name] or list(found)
    check_names([(found[place], str(place)) for place in chosen])
    return chosen


def _expanded(path: Path) -> list[Path]:
    if path.exists() or path.is_symlink():
        return [path]
    if not has_magic(str(path)):
        raise SequenceError(f"{path}: does not exist")
    if found := sorted(glob(str(path), recursive=True)):
        return [Path(one) for one in found]
    raise SequenceError(f"{path}: nothing matches this pattern")


def _at(path: Path) -> list[Path]:
    """Recordings at a path or below; the path itself where there is none."""
    place = as_given(path)
    return list(_below(place, set())) or [place]


def _below(path: Path, above: set[Path]) -> Iterator[Path]:
    """above: where links lead that would never end."""
    found: dict[Path, None] = {}
    for reader in READERS:
        paths = reader.find(path)
        if paths and path not in paths[0].parents:  # it is one itself, unless it has some of another format
            if not found:
                yield from paths
                return
        else:
            found |= dict.fromkeys(paths)
    if not path.is_dir() or ((path / NOTE).is_file() and (path / JOURNAL).is_file()):
        yield from found
        return
    above = above | {path.resolve()}
    for folder in sorted(path.iterdir()):
        if (
            folder.is_dir()
            and folder not in found
            and not folder.name.startswith(".")
            and folder.resolve() not in above
        ):
            found |= dict.fromkeys(_below(folder, above))
    yield from sorted(found)

"""Recordings of many places: of paths, of folders with all that is below them, of patterns as shells have them."""

from collections.abc import Iterable, Iterator
from glob import glob, has_magic
from pathlib import Path

from runtime.errors import SequenceError, some
from runtime.recordings.journal import JOURNAL
from runtime.recordings.registry import READERS, as_given, check_names
from runtime.recordings.run_note import NOTE


def name_of(path: Path) -> str:
    """The name that the recording at a path will have."""
    return path.stem if path.is_file() else path.name


def search_recordings(given: Iterable[Path], names: tuple[str, ...] = ()) -> list[Path]:
    """Where recordings are: at each of these paths or anywhere below; `names` picks some. Each place counts once.

    What is given and holds none is in the list too, since opening it says why. Folders in which `mos` wrote labels are
    not searched. Raises SequenceError where a path does not exist, a pattern has no match, there is no recording of a
    name, or two have one name.
    """
    paths = list(dict.fromkeys(one for path in given for place in _expanded(path) for one in _at(place)))
    if names:
        known = {name_of(path) for path in paths}
        if missing := [name for name in names if name not in known]:
            there = some(sorted(known), most=30)
            raise SequenceError(f"{some(list(map(str, given)))}: no sequence {', '.join(missing)}; there are {there}")
        paths = [path for name in dict.fromkeys(names) for path in paths if name_of(path) == name]
    check_names([(name_of(path), str(path)) for path in paths])
    return paths


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

"""Every format that can be read. A new one is a file with `TITLE`, `find` and `open_at`, and one line in `READERS`."""

import os
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from runtime.errors import NoPosesError, SequenceError, SettingError, some
from runtime.recordings import argoverse, folder, kitti, ouster_files, ros, single, velodyne_files
from runtime.recordings.breaks import with_breaks
from runtime.recordings.deskewed import deskewing
from runtime.recordings.recording import DEFAULTS, Indexed, Options


class Reader(Protocol):
    """What a format's file offers."""

    TITLE: str  # what it reads, in a few words

    def find(self, path: Path) -> list[Path]:
        """Recordings of this format at `path` or below, by what is there and what it holds; [] if there are none."""
        ...

    def open_at(self, path: Path, options: Options) -> Indexed:
        """The recording at a path that `find` gave. Raises SequenceError, PoseError or MissingPackageError."""
        ...


READERS: tuple[Reader, ...] = (
    kitti,
    argoverse,
    folder,
    ros,
    ouster_files,
    velodyne_files,
    single,
)  # the first that finds anything takes it


@dataclass(frozen=True)
class Found:
    """A recording that is there and not yet opened."""

    path: Path
    reader: Reader

    def open(self, options: Options = DEFAULTS) -> Indexed:
        """Raises SequenceError, PoseError or MissingPackageError."""
        try:
            recording = self.reader.open_at(self.path, options)
        except NoPosesError:
            if options.given_poses != "optional":
                raise
            recording = self.reader.open_at(self.path, replace(options, given_poses="ignored"))
        recording = with_breaks(recording, options)
        return deskewing(recording) if options.deskew else recording


def find_recordings(path: str | Path, names: tuple[str, ...] = ()) -> list[Found]:
    """Recordings at `path` or below; of those below, `names` picks some. Raises SequenceError where there is none."""
    given = as_given(Path(path))
    if not given.exists():
        raise SequenceError(f"{given}: does not exist")
    if given.is_file() and not given.stat().st_size:
        raise SequenceError(f"{given}: is empty, a file of 0 bytes")
    for reader in READERS:
        if paths := reader.find(given):
            break
    else:
        raise SequenceError(f"{given}: holds no recording: neither {' nor '.join(one.TITLE for one in READERS)}")
    if names and not any(given in one.parents for one in paths):
        raise SequenceError(f"{given}: is one recording; leave out its name (`names`) or give the root above it")
    there = [one.name for one in paths]
    if missing := [name for name in names if name not in there]:
        raise SequenceError(f"{given}: has no sequence {', '.join(missing)}; there are {some(there, most=30)}")
    return [Found(one, reader) for name in dict.fromkeys(names or there) for one in paths if one.name == name]


def open_recording(path: str | Path, options: Options = DEFAULTS, name: str | None = None) -> Indexed:
    """The one recording at `path` or below, or that of this name. Raises as `open_recordings`."""
    found = find_recordings(path, (name,) if name else ())
    if len(found) > 1:
        raise SequenceError(
            f"{path}: has the sequences {some([one.path.name for one in found], most=30)}; name one (`name`)"
        )
    check_options(found, options)
    return found[0].open(options)


def open_recordings(path: str | Path, names: tuple[str, ...] = (), options: Options = DEFAULTS) -> list[Indexed]:
    """All recordings at `path` or below, or those of `names`.

    Raises SequenceError, also where two have one name, SettingError, PoseError and what readers do.
    """
    found = find_recordings(path, names)
    check_options(found, options)
    opened = [one.open(options) for one in found]
    check_names([(one.name, one.source) for one in opened])
    return opened


def check_names(named: list[tuple[str, str]]) -> None:
    """Raises SequenceError where two recordings, each a name and where it is from, have one name."""
    for name, count in Counter(name for name, _ in named).items():
        if count > 1:
            alike = " and ".join([source for one, source in named if one == name][:2])
            raise SequenceError(f"{alike} have one name, so that their labels would overwrite each other; rename one")


def check_options(found: list[Found], options: Options) -> None:
    """Raises SettingError where what belongs to one recording is given for several, or topics for what has none."""
    check_count(len(found), options)
    if (options.topic or options.pose_topic or options.world) and any(one.reader is not ros for one in found):
        raise SettingError(
            f"topics and frames (`topic`, `pose_topic`, `world`) are of {ros.TITLE}, and {found[0].path} is none"
        )


def check_count(count: int, options: Options) -> None:
    """Raises SettingError where what belongs to one recording is given for several."""
    if count > 1 and (options.poses or options.calib):
        raise SettingError(f"a pose file or calibration is for one recording, not for {count}: name one (`names`)")


def as_given(path: Path) -> Path:
    """`path` made absolute without following links, so that names and neighbours are those that its user sees."""
    plain = Path(os.path.normpath(path if path.is_absolute() else os.path.join(_here(), path)))
    same = not path.exists() or (plain.exists() and plain.samefile(path))
    return plain if same else path.resolve()  # where '..' leads out of a link


def _here() -> str:
    """The working folder, with the links by which its user came there, if the shell tells them."""
    here = os.environ.get("PWD", "")
    known = os.path.isabs(here) and os.path.isdir(here) and os.path.samefile(here, ".")
    return here if known else os.getcwd()

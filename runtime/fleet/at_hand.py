"""Recordings and results of a store, in files of this machine while a task works on them."""

import atexit
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath

from runtime.errors import is_interrupt
from runtime.files import scratch
from runtime.fleet.plan import Step, Task
from runtime.fleet.remote import Remote, name_of
from runtime.fleet.store import Store
from runtime.fleet.work import Work
from runtime.recordings.journal import JOURNAL, PIECES, text_without

BY_SCAN = ("predictions", "clouds", "probabilities")  # folders of a file a scan
AT_ONCE = ("clean/*", "bag/*", "map*")  # what is made of all scans, always anew


@contextmanager
def at_hand(work: Work, task: Task) -> Iterator[tuple[Work, Task, Callable[[str], str]]]:
    """The same on files, and what to say instead of texts that name these; results are sent back at the end.

    They are, too, where a recording failed; not where the user ended it. Raises what `Store` does.
    """
    with ExitStack() as stack:
        shown: dict[str, str] = {}
        results, given = None, work.out
        if isinstance(task.place, Remote):
            if work.piece is None:
                local = _bring(task.place, stack.enter_context(scratch()))
            else:  # this process may be given its next piece
                local = _kept.bring(task.place, anew=task.step == Step.BEGIN)
            shown[str(local)] = task.place.url
            task = replace(task, place=local, source=task.place.url)
        if isinstance(given, Remote):
            folder = stack.enter_context(scratch())
            shown[str(folder)] = given.url
            results = _Results(Store(), given.key / "sequences" / task.name, folder / "sequences" / task.name)
            all_scans = work.wanted.clean or work.wanted.map or work.wanted.bag
            fresh = work.overwrite and task.step == Step.BEGIN
            results.bring(with_scans=all_scans and task.step != Step.PIECE and not fresh)
            work = replace(work, out=folder)

        def worded(text: str) -> str:
            for path, url in shown.items():
                text = text.replace(path, url)
            return text

        try:
            yield work, task, worded
        except Exception as error:
            if results and not is_interrupt(error):
                results.send()
            raise
        if results:
            results.send()


class _Kept:
    """The recording that was brought last, until another is, or the process ends."""

    def __init__(self) -> None:
        self._place: Remote | None = None
        self._path = Path()
        self._stack = ExitStack()
        atexit.register(self._stack.close)

    def bring(self, place: Remote, anew: bool) -> Path:
        """Where it lies."""
        if anew or self._place != place:
            self.release()
            self._path = _bring(place, self._stack.enter_context(scratch()))
            self._place = place
        return self._path

    def release(self) -> None:
        """Nothing of it is needed any more."""
        self._place = None
        self._stack.close()


_kept = _Kept()
release = _kept.release


def _bring(place: Remote, folder: Path) -> Path:
    """All objects of a recording, and those beside it that belong to it."""
    store, above = Store(), place.key.parent
    if place.is_file:  # and the files of its name, as the JSON of a sensor
        beside = store.sizes(above, prefix=f"{name_of(place)}.")
        store.bring(above, {key: size for key, size in beside.items() if "/" not in key}, folder)
        return folder / place.key.name
    target = folder / "sequences" / place.key.name
    store.bring(place.key, store.sizes(place.key), target)
    if len(above.parts) > 1:  # where KITTI keeps poses too
        own = f"poses/{place.key.name}.txt"
        poses = store.sizes(above.parent, prefix=own)
        store.bring(above.parent, {key: size for key, size in poses.items() if key == own}, folder)
    return target


class _Results:
    """What is written of a recording, in a folder here and at its place in the store."""

    def __init__(self, store: Store, there: PurePosixPath, here: Path) -> None:
        self._store, self._there, self._here = store, there, here
        self._before: dict[str, tuple[int, ...]] = {}
        self._made: list[str] = []  # there, of all scans at once

    def bring(self, with_scans: bool) -> None:
        """What is there. Of files of a scan the length says enough, unless `with_scans`: they come as holes."""
        sizes = self._store.sizes(self._there)
        self._made = [key for key in sizes if any(fnmatch(key, pattern) for pattern in AT_ONCE)]
        for key in self._made:
            del sizes[key]
        holes = {} if with_scans else {key: size for key, size in sizes.items() if key.startswith(BY_SCAN)}
        for key, size in holes.items():
            (self._here / key).parent.mkdir(parents=True, exist_ok=True)
            with open(self._here / key, "xb") as file:
                file.truncate(size)
        self._store.bring(self._there, {key: size for key, size in sizes.items() if key not in holes}, self._here)
        self._before = self._stamps()

    def send(self) -> None:
        """What has changed. At any moment what the journals there say is true of the labels there."""
        now = self._stamps()
        changed = [key for key in now if now[key] != self._before.get(key)]
        tops = {PurePosixPath(key).parts[0] for key in changed}
        gone = [key for key in self._before if key not in now]
        gone += [key for key in self._made if key not in now and PurePosixPath(key).parts[0] in tops]
        journals = {key for key in (*changed, *gone) if fnmatch(key, JOURNAL) or fnmatch(key, PIECES)}
        replaced = {PurePosixPath(key).stem for key in (*changed, *gone) if key in self._before} - journals
        if replaced:
            for key in journals & now.keys():
                self._store.write(text_without(self._here / key, replaced), self._there / key)
            self._store.delete(self._there, journals & set(gone))
        self._store.delete(self._there, [key for key in gone if key not in journals])
        self._store.send(self._here, [key for key in changed if key not in journals], self._there)
        self._store.send(self._here, journals & now.keys(), self._there)
        if not replaced:
            self._store.delete(self._there, journals & set(gone))
        self._before = now

    def _stamps(self) -> dict[str, tuple[int, ...]]:
        found = [path for path in self._here.rglob("*") if path.is_file()]
        stats = [(path.relative_to(self._here).as_posix(), path.stat()) for path in found]
        return {key: (stat.st_size, stat.st_mtime_ns, stat.st_ino) for key, stat in stats}

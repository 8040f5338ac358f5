"""Objects of a store (S3, by fsspec): recordings that lie there, objects that are brought here or sent there.

Keys and addresses of servers are where S3's own tools look for them; nothing of it passes through this package.
"""

import logging
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from glob import has_magic
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from runtime.compute.packages import S3FS, need_package
from runtime.errors import MosError, OutputError, SequenceError, SettingError, some
from runtime.files import scratch
from runtime.fleet.remote import SCHEME, Place, Remote, name_of, place_of
from runtime.recordings.searching import choose_of, search_recordings

log = logging.getLogger("lidar_mos.fleet")

WAITS = (0.5, 2.0, 8.0)  # s before what failed is tried again
HEAD = 1 << 16  # bytes of a file that say what it is a recording of
READ = (".pcap", ".osf")  # which others do not show by their names

T = TypeVar("T")


def find_places(given: Sequence[str], names: tuple[str, ...] = ()) -> list[Place]:
    """Where recordings are, in files and in stores, see `search_recordings`. Raises SequenceError, SettingError."""
    found: dict[Place, str] = {}
    for place in map(place_of, given):
        there = search_recordings([place]) if isinstance(place, Path) else Store().find(place)
        found |= {one: name_of(one) for one in there}
    return choose_of(found, names, some(list(given)))


class Store:
    """What can be done with objects. Each call is tried again where it fails, and then raises a MosError."""

    def __init__(self) -> None:
        """Raises MissingPackageError."""
        need_package(S3FS, f"{SCHEME}...")
        import fsspec

        self._files: Any = fsspec.filesystem("s3", use_listings_cache=False)

    def find(self, given: Remote) -> list[Remote]:
        """Recordings at an address or below it, by names alone; it may be a pattern. Raises SequenceError."""
        key = str(given.key)
        if has_magic(key) and not self.exists(given.key):
            places = self._read(given.url, lambda: self._files.glob(key))
            if not places:
                raise SequenceError(f"{given.url}: nothing matches this pattern")
        else:
            places = [key]
        return [one for place in sorted(places) for one in self._at(place)]

    def sizes(self, folder: PurePosixPath, prefix: str = "") -> dict[str, int]:
        """Objects below a folder, by their keys within it, with their bytes. prefix: of those keys."""
        found = self._read(f"{SCHEME}{folder}", lambda: self._files.find(str(folder), detail=True, prefix=prefix))
        sizes = {key.removeprefix(f"{folder}/"): one["size"] for key, one in found.items() if key != str(folder)}
        for key in sizes:
            if ".." in PurePosixPath(key).parts or key.startswith("/"):
                raise SettingError(f"{SCHEME}{folder}: the key {key!r} would lead out of its folder")
        return {key: size for key, size in sizes.items() if key and not key.endswith("/")}  # else a folder's own

    def bring(self, folder: PurePosixPath, sizes: Mapping[str, int], target: Path) -> None:
        """Objects of a folder, by their keys within it, as files. Raises SequenceError."""
        pairs = [(str(folder / key), str(target / key)) for key in sizes]
        for _, path in pairs:
            Path(path).parent.mkdir(parents=True, exist_ok=True)

        def get() -> None:
            self._files.get([one for one, _ in pairs], [path for _, path in pairs])
            for key, size in sizes.items():
                if (target / key).stat().st_size != size:
                    raise OSError(f"{key} came with {(target / key).stat().st_size} of {size} bytes")

        if pairs:
            self._read(f"{SCHEME}{folder}", get)

    def send(self, source: Path, names: Iterable[str], folder: PurePosixPath) -> None:
        """Files as objects, each whole or as it was. Raises OutputError."""
        pairs = [(str(source / name), str(folder / name)) for name in names]
        if pairs:
            self._write(folder, lambda: self._files.put([path for path, _ in pairs], [key for _, key in pairs]))

    def write(self, data: bytes, key: PurePosixPath) -> None:
        """An object. Raises OutputError."""
        self._write(key, lambda: self._files.pipe_file(str(key), data))

    def delete(self, folder: PurePosixPath, names: Iterable[str]) -> None:
        """Objects, which may be gone. Raises OutputError."""
        for name in names:
            self._write(folder, partial(self._files.rm_file, str(folder / name)))

    def exists(self, key: PurePosixPath) -> bool:
        return bool(self._read(f"{SCHEME}{key}", lambda: self._files.exists(str(key))))

    def _at(self, key: str) -> list[Remote]:
        """Recordings at a key or below. Their names are laid out here as files, and searched as those are."""
        place = PurePosixPath(key)
        url = f"{SCHEME}{key}"
        info = self._read(url, lambda: self._files.info(key))
        if info["type"] == "file":
            return [Remote(url, is_file=True)]
        with scratch() as folder:
            root = folder / place.name
            root.mkdir()
            for name in self.sizes(place):
                path = root / name
                path.parent.mkdir(parents=True, exist_ok=True)
                head = self._head(str(place / name)) if path.suffix.lower() in READ else b""
                path.write_bytes(head)
            found = search_recordings([root])
            names = [one.relative_to(root).as_posix() for one in found]
            return [Remote(SCHEME + str(place / name), path.is_file()) for name, path in zip(names, found, strict=True)]

    def _head(self, key: str) -> bytes:
        return bytes(self._read(f"{SCHEME}{key}", lambda: self._files.cat_file(key, 0, HEAD)))

    def _read(self, url: str, call: Callable[[], T]) -> T:
        return _again(url, call, SequenceError)

    def _write(self, key: PurePosixPath, call: Callable[[], object]) -> None:
        _again(f"{SCHEME}{key}", call, OutputError)


def _again(url: str, call: Callable[[], T], error: type[MosError]) -> T:
    """What `call` returns, once it does."""
    for wait in (*WAITS, None):
        try:
            return call()
        except FileNotFoundError:
            raise error(f"{url}: does not exist") from None
        except PermissionError as reason:
            raise error(f"{url}: the store refuses it: {reason}") from reason
        except Exception as reason:  # of any library below
            if wait is None:
                raise error(f"{url}: {type(reason).__name__}: {reason}") from reason
            log.warning("%s: %s, tried again in %g s", url, type(reason).__name__, wait)
            time.sleep(wait)
    raise AssertionError("the last try returns or raises")

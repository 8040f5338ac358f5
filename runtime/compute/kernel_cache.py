"""Compiled kernels on disk, where Numba would put them: one file each for every signature and processor.

A file is a checksum of all that follows, what the code was made from, and the code. One that is damaged is thrown away
and made anew, with a line in the log; a stale one is written over. Where no folder is writable or the disk is full,
kernels are compiled in every process instead, warned of once.
"""

import contextlib
import functools
import logging
import warnings
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from runtime.compute import internals
from runtime.compute.origin import ingredients
from runtime.errors import MosWarning, OutputError
from runtime.files import open_ordinary, read_ordinary, write_whole

log = logging.getLogger("lidar_mos")

_SIZE = sha256().digest_size
_warned = False


def keep(kernel: Any) -> None:
    """Let a kernel take its compiled code from disk, and put it there."""
    try:
        try:
            internals.set_cache(kernel, KernelCache(kernel.py_func))
        except internals.MISSING:
            internals.say_missing("its own cache of kernels is used, which checks nothing")
            with contextlib.suppress(*internals.MISSING):
                kernel.enable_caching()
    except RuntimeError as error:  # no folder is writable
        _warn(str(error))


def is_kept(kernel: Any) -> bool:
    """Whether code of a kernel for this processor lies on disk."""
    cache = internals.cache_of(kernel)
    return isinstance(cache, KernelCache) and cache.holds_any()


class KernelCache:
    """The files of one kernel. Its methods are those that Numba calls."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Raises what `internals.Storable` does."""
        self._function = function
        self._kernel = internals.Storable(function)

    @property
    def cache_path(self) -> str:
        """The folder."""
        return str(self._kernel.folder)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Compiled code, or None where it is not there."""
        path = self._path(signature)
        try:
            content = read_ordinary(path)
        except FileNotFoundError:
            return None
        except OSError as error:
            log.warning("%s cannot be read (%s): the kernel is compiled anew", path, error)
            return None
        try:
            if content[:_SIZE] != sha256(content[_SIZE:]).digest():
                raise ValueError("its checksum does not fit")
            if content[_SIZE : 2 * _SIZE] != self._origin:  # of another version
                return None
            return self._kernel.from_bytes(context, content[2 * _SIZE :])
        except Exception as error:  # whatever it is, the kernel can be compiled
            log.warning("%s is damaged (%s): the kernel is compiled anew", path, error)
            with contextlib.suppress(OSError):
                path.unlink()
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Write compiled code. Warns (MosWarning) once in a process where that fails."""
        try:
            if (data := self._kernel.to_bytes(compiled)) is not None:
                content = self._origin + data
                write_whole(self._path(signature), sha256(content).digest() + content, sync=False)  # its checksum tells
        except OutputError as error:
            _warn(str(error.__cause__ or error))
        except internals.MISSING:
            internals.say_missing("kernels are compiled in every process")

    @functools.cached_property
    def _origin(self) -> bytes:
        """Of what the code is made, when it is needed: its module is then complete."""
        return sha256((self._kernel.version + ingredients(self._function)).encode()).digest()

    def holds_any(self) -> bool:
        """Whether there is code for this processor, of whatever signature."""
        for path in self._kernel.folder.glob(f"{self._prefix}*"):
            with contextlib.suppress(OSError), open_ordinary(path) as file:
                if file.read(2 * _SIZE)[_SIZE:] == self._origin:
                    return True
        return False

    def flush(self) -> None:
        """Throw away what there is for this processor."""
        for path in self._kernel.folder.glob(f"{self._prefix}*"):
            path.unlink(missing_ok=True)

    @property
    def _prefix(self) -> str:
        return f"{self._kernel.name}-{_short(internals.target())}-"

    def _path(self, signature: Any) -> Path:
        return self._kernel.folder / f"{self._prefix}{_short(signature)}.kernel"


def _short(key: object) -> str:
    return sha256(repr(key).encode()).hexdigest()[:12]


def _warn(reason: str) -> None:
    global _warned
    if not _warned:
        _warned = True
        warnings.warn(
            f"compiled kernels cannot be kept ({reason}): they are compiled again in every process, which takes 20 to "
            "60 s. Make space, or set NUMBA_CACHE_DIR to a folder that is writable",
            MosWarning,
            stacklevel=2,
        )

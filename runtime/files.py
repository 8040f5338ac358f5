"""Files and folders that are whole or absent. Everything that replaces one does it here."""

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

from runtime.errors import CutShortError, MosError, OutputError

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

_SCRATCH = "lidar-mos-"
_NEW = 60.0  # s in which a folder may not be locked yet by the process that makes it
_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{8}\.(part|old)")


def read_ordinary(path: str | Path, most: int | None = None) -> bytes:
    """What a file holds, see `open_ordinary`; most: bytes, of which more are an OSError too."""
    with open_ordinary(path) as file:
        if most is not None and os.fstat(file.fileno()).st_size > most:
            raise OSError(errno.EFBIG, f"it is larger than {most:,} bytes", str(path))
        return file.read()


def open_ordinary(path: str | Path) -> BufferedReader:
    """A file to read, which is one: a pipe would be waited for, and a device may have no end. Raises OSError."""
    number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise OSError(errno.EINVAL, "it is no ordinary file", str(path))
    return open(number, "rb")


@contextlib.contextmanager
def locked(folder: Path, shared: bool = False, wait: float = 3.0) -> Iterator[None]:
    """Within, no other process (nor call) may be in such a block of this folder, which is made as needed.

    shared: but for others that share it. wait: s, for a process that is ending. The lock is the system's own: it ends
    with the process, however that ends. On Windows, and where a file system has none, there is no lock. Raises
    OutputError where another has it.
    """
    if fcntl is None:
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise OutputError(f"cannot write into {folder}: {error.strerror}; choose another place") from error
    try:
        try:
            _lock(held, fcntl.LOCK_SH if shared else fcntl.LOCK_EX, wait)
        except BlockingIOError as error:
            raise OutputError(
                f"{folder}: another run writes there just now; let it end, or choose another place (`out`)"
            ) from error
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(held)


def _lock(held: int, how: int, wait: float) -> None:
    """Raises BlockingIOError where another has it for longer."""
    assert fcntl
    until = time.monotonic() + wait
    while True:
        try:
            fcntl.flock(held, how | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= until:
                raise
            time.sleep(0.05)


def sweep(folder: Path) -> None:
    """Delete what `replacing` and `replacing_folder` left, anywhere below, in processes that were killed within.

    Only where nobody else writes there, see `locked`.
    """
    for left in folder.rglob(".*"):
        if not _TEMPORARY.fullmatch(left.name):
            continue
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                left.unlink(missing_ok=True)


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """A new folder where the system keeps temporary files, gone with the block.

    What processes left of such that were killed within is cleared away. Raises OutputError.
    """
    try:
        folder = Path(tempfile.mkdtemp(prefix=_SCRATCH))
    except OSError as error:
        raise OutputError(f"cannot make a folder for temporary files: {error}; set TMPDIR to another place") from error
    with locked(folder):
        for left in folder.parent.glob(f"{_SCRATCH}*") if fcntl else ():
            with contextlib.suppress(OutputError, OSError), locked(left, wait=0):  # else it is in use
                if time.time() - left.stat().st_mtime > _NEW:
                    shutil.rmtree(left, ignore_errors=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def delete(file: Path) -> None:
    """Delete a file that may be there. Raises OutputError."""
    try:
        file.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot delete {file}: {error.strerror}") from error


def write_whole(path: str | Path, data: bytes | memoryview, sync: bool = True) -> None:
    """Write `data` to `path` as `replacing` does."""
    with replacing(path, sync) as file:
        file.write(data)


@contextlib.contextmanager
def replacing(path: str | Path, sync: bool = True) -> Iterator[BinaryIO]:
    """A new file to write into; it becomes `path` when the block ends, so that nobody ever sees half a file.

    Folders are made as needed; a link at `path` is replaced, not followed. sync: wait until the disk has the data, so
    that the file is whole even after a power failure. Raises OutputError where that fails; an older file at `path` then
    stays as it was, as it does where the block raises.
    """
    with _beside(path) as part:
        if os.path.exists(path) and not os.path.isfile(path):
            raise OutputError(f"{path}: is there already and is no file; choose another name")
        try:
            with open(part, "xb") as file:  # never opens what lies there, a link for example
                yield file
                file.flush()
                if sync:
                    os.fsync(file.fileno())
            os.replace(part, path)
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)


@contextlib.contextmanager
def replacing_folder(path: str | Path) -> Iterator[Path]:
    """A new folder to write into; it becomes `path` when the block ends, in the place of what was there.

    Links and errors as in `replacing`; after a CutShortError it stays where it is, until the next `sweep`.
    """
    with _beside(path) as part:
        kept = False
        try:
            part.mkdir()
            yield part
            _sync(part)
            _swap(part, Path(os.path.abspath(path)))
        except CutShortError:
            kept = True
            raise
        finally:
            if not kept:
                shutil.rmtree(part, ignore_errors=True)


@contextlib.contextmanager
def _beside(path: str | Path) -> Iterator[Path]:
    """A name in the folder of `path` that nobody else uses; what the system refuses becomes OutputError."""
    place = Path(os.path.abspath(path))  # not resolved: of a link, its own folder
    part = place.with_name(f".{place.name}.{secrets.token_hex(4)}.part")  # as _TEMPORARY has it
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        yield part
    except MosError:
        raise
    except OSError as error:
        reason = error.strerror or str(error)
        if error.filename and not str(error.filename).startswith(str(part)):
            reason += f" ({error.filename})"
        raise OutputError(
            f"cannot write {path}: {reason}. What was there is as it was; free the space or choose another place"
        ) from error


def _sync(folder: Path) -> None:
    """Wait until the disk has every file of a folder."""
    for file in folder.rglob("*"):
        if file.is_file() and not file.is_symlink():
            with open(file, "rb" if os.name == "posix" else "rb+") as written:  # Windows: only of what may be written
                os.fsync(written.fileno())


def _swap(new: Path, target: Path) -> None:
    """Put the folder `new` in the place of `target`; if that fails, `target` is as it was."""
    if not os.path.lexists(target):
        os.rename(new, target)
        return
    old = new.with_suffix(".old")
    os.rename(target, old)
    try:
        os.rename(new, target)
    except BaseException:
        os.rename(old, target)
        raise
    if old.is_dir() and not old.is_symlink():
        shutil.rmtree(old, ignore_errors=True)
    else:
        old.unlink(missing_ok=True)

"""Files that are whole or absent."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from runtime.errors import MosError, OutputError


def write_whole(path: Path, data: bytes) -> None:
    """Write `data` to `path` as `replacing` does."""
    with replacing(path) as part:
        part.write_bytes(data)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file beside `path` to write into, moved into place at the end, so that nobody ever sees half a file.

    Folders are made as needed. Raises OutputError where that fails; an older file at `path` then stays as it
    was, as it does where the block raises.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield part
            os.replace(part, path)
        except BaseException:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
            raise
    except MosError:
        raise
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write {path}: {reason}. Free the space or choose another output folder") from error

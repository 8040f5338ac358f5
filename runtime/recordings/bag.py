"""A bag of ROS 1 or 2 as a stream of messages, by `rosbags`, whatever its errors are called."""

import warnings
import weakref
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import get_ident
from typing import Any

from runtime.compute.packages import ROSBAGS, need_package
from runtime.errors import MosWarning, ScanError, SequenceError
from runtime.files import open_ordinary
from runtime.recordings.old_rosbags import NOTE, as_folder, is_old

TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")  # the second of old bags of ROS 1
ROS1, MCAP, SQLITE = b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0"
MAGIC = {".bag": ROS1, ".mcap": MCAP, ".db3": SQLITE}
JOURNALS = ("-wal", "-journal")  # of SQLite
REPAIR = {
    ".bag": "if it was cut off, `rosbag reindex` may repair it",
    ".mcap": "if it was cut off, `mcap recover` may repair it",
    ".db3": "if it was cut off, `ros2 bag reindex` or `sqlite3 .recover` may repair it",
}


@dataclass(frozen=True)
class Message:
    """One message of a topic."""

    received: int  # ns
    data: bytes  # serialised


def is_bag(path: Path) -> bool:
    """Whether a file is a bag by its name, or a folder has what makes it one."""
    if path.is_dir():
        return (path / NOTE).is_file() and any(file.suffix in MAGIC for file in path.iterdir())
    return path.suffix in MAGIC and path.is_file()


class Bag:
    """An open bag. It is closed when nobody has it any more."""

    def __init__(self, path: Path) -> None:
        """Raises SequenceError, MissingPackageError."""
        if path.is_file() and not _begins_with(path, MAGIC[path.suffix]):
            raise SequenceError(f"{path}: is no bag of ROS: it does not begin as one; was it cut off or overwritten?")
        need_package(ROSBAGS, f"{path}: a bag of ROS")
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.path, self.ros1 = path, path.suffix == ".bag" and path.is_file()
        self._types = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        for kind in TF:  # which ROS 1 has in a package of its own
            if kind not in self._types.types:
                self._types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", kind))
        self._thread, self._place = get_ident(), path
        try:
            if not self.ros1 and is_old():
                links = TemporaryDirectory()
                weakref.finalize(self, links.cleanup)
                self._place = as_folder(path, Path(links.name))
            self._reader = self._open()
        except Exception as error:  # of rosbags, of SQLite, of what unpacks: there is no common base
            repair = f"; {REPAIR[path.suffix]}" if path.suffix in REPAIR else ""
            raise SequenceError(f"{path}: cannot be read as a bag: {_text(error)}{repair}") from error
        weakref.finalize(self, self._reader.close)
        _warn_of_journals(path)

    def _open(self) -> Any:
        from rosbags import rosbag1, rosbag2

        reader = (rosbag1 if self.ros1 else rosbag2).Reader(self._place)
        reader.open()
        return reader

    def topics(self) -> dict[str, tuple[str, int]]:
        """Type and number of messages of every topic."""
        counts = Counter[tuple[str, str]]()
        for one in self._reader.connections:
            counts[one.topic, one.msgtype] += one.msgcount
        return {topic: (kind, count) for (topic, kind), count in counts.items()}

    def span(self) -> tuple[float, float] | None:
        """When its first message and its last one came, s; None where it does not say."""
        try:
            return 1e-9 * self._reader.start_time, 1e-9 * self._reader.end_time
        except KeyError:  # of a note that `as_folder` wrote
            return None

    def messages(self, topic: str, start: int | None = None, skip: int = 0) -> Iterator[Message]:
        """Those of a topic in the order of the bag, from time `start` ns on but for the first `skip`.

        Raises ScanError where the bag is broken.
        """
        before = None if start is None else start - 1  # rosbags 0.9 leaves out chunks that end at `start`
        own = get_ident() == self._thread  # SQLite's objects are of one thread, and so are places in a file
        try:
            reader = self._reader if own else self._open()
            try:
                topics = [one for one in reader.connections if one.topic == topic]
                there = (Message(time, data) for _, time, data in reader.messages(topics, before))
                yield from islice((one for one in there if start is None or one.received >= start), skip, None)
            finally:
                if not own:
                    reader.close()
        except Exception as error:  # as above
            raise ScanError(f"the bag is broken: {_text(error)}") from error

    def connections(self) -> list[Any]:
        """Who sent what on which topic."""
        return list(self._reader.connections)

    def everything(self) -> Iterator[tuple[Any, int, bytes]]:
        """All messages in the order of the bag: connection, time in ns, and what was serialised. Raises ScanError."""
        try:
            yield from self._reader.messages()
        except Exception as error:  # as above
            raise ScanError(f"{self.path}: the bag is broken: {_text(error)}") from error

    def encoded(self, content: Any, kind: str) -> bytes:
        """A message of a type that ROS itself brings, serialised."""
        encode = self._types.serialize_ros1 if self.ros1 else self._types.serialize_cdr
        return bytes(encode(content, kind))

    def decoded(self, message: Message, kind: str, where: str) -> Any:
        """The content of a message of a type that ROS itself brings. Raises ScanError, beginning with `where`."""
        try:
            decode = self._types.deserialize_ros1 if self.ros1 else self._types.deserialize_cdr
            return decode(message.data, kind)
        except Exception as error:
            raise ScanError(f"{where}: cannot be read as {kind}: {_text(error)}") from error


def _begins_with(path: Path, magic: bytes) -> bool:
    try:
        with open_ordinary(path) as file:
            return file.read(len(magic)) == magic
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read: {error.strerror}") from error


def _warn_of_journals(path: Path) -> None:
    for file in [path] if path.is_file() else sorted(path.iterdir()):
        for journal in (file.with_name(file.name + end) for end in JOURNALS):
            if file.suffix == ".db3" and journal.is_file() and journal.stat().st_size:
                warnings.warn(
                    f"{file}: {journal.name} beside it holds what was written last, and is not read; "
                    f"`sqlite3 {file.name} 'PRAGMA wal_checkpoint'` puts it in",
                    MosWarning,
                    stacklevel=2,
                )


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(": .")

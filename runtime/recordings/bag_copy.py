"""A copy of a bag in which clouds are changed, and all other messages are byte for byte the same."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from runtime.errors import CutShortError, MosError, OutputError, SettingError
from runtime.recordings.bag import Bag, Message
from runtime.recordings.old_rosbags import is_old
from runtime.recordings.ros_topics import CLOUD

UNKNOWN = "RIHS01_" + 64 * "0"  # digest of a type that a bag does not say
Edit = Callable[[Any, str], Any]  # from a PointCloud2, and what to call it in messages, to another
ROOM = 16 << 20  # bytes that are left free, in which a copy that is cut short gets its index
NO_MORE: tuple[int, Edit] = (-1, lambda cloud, where: cloud)


def copy_bag(bag: Bag, topic: str, folder: Path, changed: Iterator[tuple[int, Edit]]) -> Path:
    """Copy a bag into `folder`, as a file .bag, or as a folder of the kind that it is. What was compressed is no more.

    changed: the numbers of clouds of `topic`, in order, and what becomes of them; clouds that are not there are left
    out. Before the disk is full it ends: the messages until then are whole, and can be read. Raises CutShortError then,
    and OutputError, ScanError, SettingError.
    """
    path = folder / bag.path.name if bag.ros1 else folder / bag.path.stem
    number, (wanted, edit) = -1, next(changed, NO_MORE)
    written, full = 0, False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _writer(bag, path) as writer:
            connections: dict[tuple[str, str, str], Any] = {}
            for one in bag.connections():
                connections[_key(one)] = connections.get(_key(one)) or _added(writer, one, bag.ros1)
            for connection, time, data in bag.everything():
                if connection.topic == topic:
                    number += 1
                    if number != wanted:
                        continue
                    where = f"{bag.path}: scan {number} of {topic}"
                    data = bag.encoded(edit(bag.decoded(Message(time, data), CLOUD, where), where), CLOUD)
                    wanted, edit = next(changed, NO_MORE)
                full = shutil.disk_usage(folder).free < ROOM + 2 * len(data)
                if full:
                    break
                writer.write(connections[_key(connection)], time, data)
                written += 1
    except (MosError, OSError):
        raise
    except Exception as error:  # of rosbags, of SQLite: there is no common base
        raise OutputError(f"cannot write {path}: {type(error).__name__}: {error}") from error
    if full:
        raise CutShortError(
            f"the disk is full after {written:,} messages: they are whole, in {path}, until the next run there. Free "
            "the space or choose another place, and give the same command again"
        )
    return path


def _writer(bag: Bag, path: Path) -> Any:
    from rosbags import rosbag1, rosbag2

    if bag.ros1:
        return rosbag1.Writer(path)
    mcap = any(file.suffix == ".mcap" for file in ([bag.path] if bag.path.is_file() else bag.path.iterdir()))
    if is_old():
        if mcap or bag.path.is_file():
            raise SettingError(
                f"{bag.path}: this rosbags, to which ouster-sdk holds, copies neither MCAP nor single files; use a "
                "folder of .db3, or a newer rosbags in an environment of its own"
            )
        return rosbag2.Writer(path)
    plugin = rosbag2.StoragePlugin.MCAP if mcap else rosbag2.StoragePlugin.SQLITE3
    return rosbag2.Writer(path, version=8, storage_plugin=plugin)


def _key(connection: Any) -> tuple[str, str, str]:
    return connection.topic, connection.msgtype, repr(connection.ext)


def _added(writer: Any, connection: Any, ros1: bool) -> Any:
    """The same topic, of the same type and quality, in the copy."""
    topic, kind, definition, extra = connection.topic, connection.msgtype, connection.msgdef, connection.ext
    definition = getattr(definition, "data", definition)  # rosbags 0.9 has it as it is
    if ros1:
        return writer.add_connection(
            topic, kind, msgdef=definition, md5sum=connection.digest, callerid=extra.callerid, latching=extra.latching
        )
    return writer.add_connection(
        topic,
        kind,
        msgdef=definition,
        rihs01=connection.digest or UNKNOWN,
        serialization_format=extra.serialization_format,
        offered_qos_profiles=extra.offered_qos_profiles,
    )

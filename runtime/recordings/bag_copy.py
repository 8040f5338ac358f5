"""A copy of a bag in which clouds lack some of their points, and all other messages are byte for byte the same."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from runtime.errors import MosError, OutputError
from runtime.recordings.bag import Bag, Message
from runtime.recordings.pointcloud2_edits import without
from runtime.recordings.ros_topics import CLOUD

UNKNOWN = "RIHS01_" + 64 * "0"  # digest of a type that a bag does not say
NO_MORE = (-1, np.empty(0, np.bool_))


def copy_bag(bag: Bag, topic: str, folder: Path, kept: Iterator[tuple[int, npt.NDArray[np.bool_]]]) -> Path:
    """Copy a bag into `folder`, as a file .bag, or as a folder of the kind that it is. What was compressed is no more.

    kept: the numbers of clouds of `topic`, in order, and which of their points (N,) stay; clouds that are not there are
    left out. Raises OutputError, ScanError.
    """
    path = folder / bag.path.name if bag.ros1 else folder / bag.path.stem
    number, (wanted, keep) = -1, next(kept, NO_MORE)
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
                    cloud = bag.decoded(Message(time, data), CLOUD, f"{bag.path}: scan {number} of {topic}")
                    data = bag.encoded(without(cloud, keep), CLOUD)
                    wanted, keep = next(kept, NO_MORE)
                writer.write(connections[_key(connection)], time, data)
    except (MosError, OSError):
        raise
    except Exception as error:  # of rosbags, of SQLite: there is no common base
        raise OutputError(f"cannot write {path}: {type(error).__name__}: {error}") from error
    return path


def _writer(bag: Bag, path: Path) -> Any:
    from rosbags import rosbag1, rosbag2

    if bag.ros1:
        return rosbag1.Writer(path)
    mcap = any(file.suffix == ".mcap" for file in ([bag.path] if bag.path.is_file() else bag.path.iterdir()))
    plugin = rosbag2.StoragePlugin.MCAP if mcap else rosbag2.StoragePlugin.SQLITE3
    return rosbag2.Writer(path, version=8, storage_plugin=plugin)


def _key(connection: Any) -> tuple[str, str, str]:
    return connection.topic, connection.msgtype, repr(connection.ext)


def _added(writer: Any, connection: Any, ros1: bool) -> Any:
    """The same topic, of the same type and quality, in the copy."""
    topic, kind, definition, extra = connection.topic, connection.msgtype, connection.msgdef.data, connection.ext
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

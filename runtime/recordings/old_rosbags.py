"""Bags of ROS 2 for rosbags 0.9, to which ouster-sdk holds: it reads folders with a note up to version 8, no files."""

import json
import sqlite3
from contextlib import closing
from importlib.metadata import version
from pathlib import Path
from typing import Any

NOTE, BAG = "metadata.yaml", "rosbag2_bagfile_information"
NEWEST = 8  # version of the note
MCAP = ".mcap"


def is_old() -> bool:
    """Whether this rosbags is installed."""
    return version("rosbags").startswith("0.9.")


def as_folder(path: Path, empty: Path) -> Path:
    """A folder like the bag at `path`: itself, or `empty`, into which links and a note go. Raises what reading does."""
    if path.is_dir():
        from ruamel.yaml import YAML

        note = dict(YAML(typ="safe").load((path / NOTE).read_text())[BAG])
        if note["version"] <= NEWEST:
            return path
        files = [path / Path(one).name for one in note["relative_file_paths"]]
        note["version"] = NEWEST
    else:
        note, files = _note(path), [path]
    for file in files:
        (empty / file.name).symlink_to(file.resolve())
    (empty / NOTE).write_text(json.dumps({BAG: note}))
    return empty


def _note(path: Path) -> dict[str, Any]:
    """What the note of a file says: only what is asked."""
    topics = _topics_of_mcap(path) if path.suffix == MCAP else _topics_of_sqlite(path)
    return {
        "version": NEWEST,
        "storage_identifier": path.suffix[1:] if path.suffix == MCAP else "sqlite3",
        "relative_file_paths": [path.name],
        "topics_with_message_count": [
            {"message_count": count, "topic_metadata": {"name": name, "type": kind, "serialization_format": encoding}}
            for name, kind, encoding, count in topics
        ],
    }


def _topics_of_mcap(path: Path) -> list[tuple[str, str, str, int]]:
    """Name, type, encoding and number of messages; the number is 1 where there is no index."""
    from rosbags.rosbag2.storage_mcap import MCAPFile

    file = MCAPFile(path)
    file.open()
    file.get_schema_definitions()
    counts = {key: sum(chunk.channel_count.get(key, 0) for chunk in file.chunks) for key in file.channels}
    file.close()
    return [(one.topic, one.schema, one.message_encoding, counts[key] or 1) for key, one in file.channels.items()]


def _topics_of_sqlite(path: Path) -> list[tuple[str, str, str, int]]:
    query = """SELECT name, type, serialization_format, COUNT(messages.id)
        FROM topics LEFT JOIN messages ON messages.topic_id = topics.id GROUP BY topics.id"""
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as database:
        return database.execute(query).fetchall()

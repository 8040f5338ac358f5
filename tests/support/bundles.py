"""Bundles that are made from the tiny one."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

from runtime.bundle.loading import load_bundle, sha256_of
from runtime.bundle.manifest import MANIFEST, Decision, SensorEntry
from runtime.sensors.registry import SENSORS
from tests.support.paths import BUNDLE


def for_sensors(folder: Path, *names: str, width: int = 256) -> Path:
    """The tiny bundle as one for these sensors, each with narrow images and a threshold of its own."""
    target = Path(shutil.copytree(BUNDLE, folder / "bundle"))
    values = json.loads((target / MANIFEST).read_text())
    values["sensors"] = [
        asdict(
            SensorEntry(
                name,
                replace(SENSORS[name].range_image, width=width),
                SENSORS[name].reach,
                Decision(0.3 + 0.01 * i, 0.3 + 0.01 * i),
            )
        )
        for i, name in enumerate(names)
    ]
    (target / MANIFEST).write_text(json.dumps(values))
    assert [one.name for one in load_bundle(target).manifest.sensors] == list(names)
    return target


def with_file(folder: Path, name: str, data: bytes) -> Path:
    """A bundle with another file in it, of which its manifest speaks."""
    (folder / name).write_bytes(data)
    values = json.loads((folder / MANIFEST).read_text())
    values["files"][name] |= {"sha256": sha256_of(folder / name), "bytes": len(data)}
    (folder / MANIFEST).write_text(json.dumps(values))
    return folder

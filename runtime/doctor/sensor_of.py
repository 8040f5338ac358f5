"""The sensor that a runner takes the scans of a recording for, and the recording in the frame of that sensor."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from runtime.bundle.choice import Choice, choose_before, choose_from
from runtime.bundle.manifest import Manifest
from runtime.errors import MosError
from runtime.recordings.around import Around
from runtime.recordings.poses import Pose, Poses, relative_pose
from runtime.recordings.recording import Indexed, Scan
from runtime.recordings.scans import moved
from runtime.sensors.finding import find_from_scan
from runtime.sensors.sensor import Sensor

FIRST = 50  # scans that are looked at until one shows its sensor


def sensor_of(recording: Indexed, manifest: Manifest, given: Sensor | None) -> Choice:
    """As `MosRunner` chooses it: given, the bundle's only one, or found in the first scan that shows any."""
    if chosen := choose_before(manifest, given):
        return chosen
    for index in range(min(FIRST, len(recording))):
        with suppress(MosError):  # of a broken scan, which is said elsewhere
            scan = recording.read(index)
            if found := find_from_scan(scan.data, scan.ring):
                return choose_from(manifest, found)
    return Choice(manifest.sensor, f"no scan shows its sensor: as {manifest.sensor.name}, the first of the bundle")


def in_own_frame(recording: Indexed, chosen: Choice) -> Indexed:
    """The recording as the network sees it."""
    return recording if chosen.mounting is None else _OwnFrame(recording, chosen.mounting)


class _OwnFrame(Around):
    """Scans and poses of another frame, taken into that of the sensor."""

    def __init__(self, within: Indexed, mounting: Pose) -> None:
        super().__init__(within)
        self._mounting, self._back = mounting, relative_pose(mounting, np.eye(4))
        self.poses = None if within.poses is None else within.poses @ self._back

    def seen(self, index: int, scan: Scan) -> Scan:
        pose = None if scan.pose is None else scan.pose @ self._back
        return replace(scan, data=moved(scan.data, self._mounting), pose=pose)

    def other_poses(self) -> dict[str, Poses]:
        return {meaning: poses @ self._back for meaning, poses in super().other_poses().items()}

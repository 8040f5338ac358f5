"""A recording of scans, labels and poses on a timeline, for the 3D viewer Rerun."""

import os
import sysconfig
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from runtime.errors import OutputError
from runtime.files import replacing
from runtime.pictures.snapshot import Snapshot
from runtime.pictures.verdict import BACKGROUND, CAR_PAINT, COLOURS, STILL, verdict

TIMELINE = "scan"
PATH, LIDAR = "world/path", "world/lidar"  # LIDAR is where the sensor is; what it saw lies below
CAR = (2.1, 0.9, 0.7)  # m, half the length, width and height of the car
TABLE = np.array([COLOURS[kind] for kind in sorted(COLOURS)], np.uint8)  # by kind
SIZES = np.where(np.arange(len(COLOURS)) > STILL, 3.0, 1.5)  # of points, by kind, in pixels of the screen


def open_viewer() -> rr.RecordingStream:
    """What Rerun's viewer plays as it comes: it is opened, unless it is open already. Raises OutputError."""
    stream, path = rr.RecordingStream("lidar-mos"), os.environ.get("PATH", "")
    os.environ["PATH"] = os.pathsep.join([sysconfig.get_path("scripts"), path])  # where `rerun` was installed
    try:
        stream.spawn()
    except RuntimeError as error:
        raise OutputError(f"Rerun's viewer cannot be opened: {error}") from error
    finally:
        os.environ["PATH"] = path
    return stream


def record(path: Path, shown: Iterable[Snapshot], viewers: Sequence[rr.RecordingStream] = ()) -> int:
    """Write snapshots to an .rrd file, one at a time; how many there were. Raises OutputError.

    viewers: are shown each as soon as it is there.

    Entities: world/path, world/lidar (the pose), below that a car, the points as each system sees them, in the colours
    of `verdict`, and as the labels do.
    """
    places: list[NDArray[np.float64]] = []
    with replacing(path) as file:
        stream = rr.RecordingStream("lidar-mos")
        made = rr.binary_stream(stream)  # in memory: Rerun's own writer of files swallows what a full disk says
        try:
            for snapshot in shown:
                places.append(snapshot.pose[:3, 3])
                for one in (stream, *viewers):
                    _log(one, snapshot, places)
            file.write(made.read() or b"")  # once: every reading is a whole file of its own
        finally:
            for one in (stream, *viewers):
                one.disconnect()
    return len(places)


def _log(stream: rr.RecordingStream, snapshot: Snapshot, places: list[NDArray[np.float64]]) -> None:
    """The next scan, and the path up to there."""
    if len(places) == 1:
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.set_time(TIMELINE, sequence=snapshot.index)
    stream.log(PATH, rr.LineStrips3D([np.array(places)], colors=[CAR_PAINT]))
    views = _log_scan(stream, snapshot)
    if len(places) == 1:
        stream.send_blueprint(_layout(views))


def _log_scan(stream: rr.RecordingStream, snapshot: Snapshot) -> list[str]:
    """Pose and points of one scan; the names of the systems, and "labels" where there are any."""
    pose, truth = snapshot.pose, snapshot.classes
    stream.log(LIDAR, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    stream.log(f"{LIDAR}/car", rr.Boxes3D(half_sizes=[CAR], colors=[CAR_PAINT]), static=True)
    shown = {name: verdict(moving, truth) for name, moving in snapshot.moving.items()}
    if truth is not None:
        shown["labels"] = verdict(None, truth)
    for name, kinds in shown.items():
        points = rr.Points3D(snapshot.points[:, :3], colors=TABLE[kinds], radii=rr.Radius.ui_points(SIZES[kinds]))
        stream.log([*LIDAR.split("/"), name], points)
    return list(shown)


def _layout(names: list[str]) -> rrb.Blueprint:
    """A 3D view for each of `names`, side by side, all with the path and the car."""
    views = [
        rrb.Spatial3DView(
            origin="world",
            name=name,
            contents=[PATH, LIDAR, f"{LIDAR}/car", f"{LIDAR}/{rr.escape_entity_path_part(name)}"],
            background=BACKGROUND,
        )
        for name in names
    ]
    return rrb.Blueprint(rrb.Horizontal(*views), collapse_panels=True)

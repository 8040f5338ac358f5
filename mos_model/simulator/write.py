"""Simulated drives on disk, laid out as SemanticKITTI: `mos simulate OUT`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mos_model.simulator.sequence import Simulation, simulate
from runtime.classes import MOVING, to_classes
from runtime.errors import OutputError, SettingError
from runtime.files import replacing_folder
from runtime.recordings.poses import relative_pose
from runtime.sensors.registry import DEFAULT_SENSOR, open_sensor
from runtime.sensors.sensor import Sensor

# T_camera_lidar of a camera that looks forward, a little below and before the LiDAR (KITTI's `Tr`).
CAMERA_FROM_LIDAR = np.array(
    ((0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, -0.08), (1.0, 0.0, 0.0, -0.27), (0.0, 0.0, 0.0, 1.0))
)


@dataclass(frozen=True)
class WrittenDataset:
    """What `write_dataset` wrote."""

    path: Path
    sequences: int
    scans: int
    points: int
    moving_points: int


def write_dataset(
    out: str | Path,
    sequences: int = 1,
    frames: int = 100,
    seed: int = 0,
    sensor: str | Sensor = DEFAULT_SENSOR,
    progress: Callable[[int, int], object] | None = None,
    **settings: Any,
) -> WrittenDataset:
    """Write `sequences` simulated drives of `frames` scans each to the new folder `out`, whole or not at all.

    Layout: sequences/NN/{velodyne/*.bin, labels/*.label, poses.txt, calib.txt, times.txt}; poses are those of
    the simulated odometry, in the camera's frame as KITTI has them. `progress(done, total)` is called after
    each scan; `settings` are the fields of `SimulationSettings`. Raises SettingError for settings that cannot
    be, OutputError where `out` holds something already or cannot be written.
    """
    if not isinstance(sequences, int) or not 1 <= sequences <= 1000:
        raise SettingError(f"sequences must be a whole number within 1..1000, not {sequences!r}")
    if not isinstance(seed, int) or seed < 0:
        raise SettingError(f"seed must be a whole number of at least 0, not {seed!r}")
    profile = open_sensor(sensor)
    target = Path(out)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise OutputError(f"{target} exists already: name a new or an empty folder")
    counts = np.zeros(2, np.int64)
    with replacing_folder(target) as folder:
        for index in range(sequences):
            drive = simulate(sequence_seed(seed, index), frames, profile, **settings)

            def report(done: int, before: int = index * frames) -> None:
                if progress is not None:
                    progress(before + done, sequences * frames)

            counts += _write_sequence(folder / "sequences" / f"{index:02d}", drive, report)
        if target.exists():
            target.rmdir()  # only if it is still empty
    return WrittenDataset(target, sequences, sequences * frames, int(counts[0]), int(counts[1]))


def sequence_seed(seed: int, index: int) -> int:
    """The seed of drive `index` of a data set."""
    return int(np.random.SeedSequence((seed, index)).generate_state(1)[0])


def _write_sequence(folder: Path, drive: Simulation, report: Callable[[int], None]) -> np.ndarray:
    """Write one drive; returns its points and moving points."""
    (folder / "velodyne").mkdir(parents=True)
    (folder / "labels").mkdir()
    points = moving = 0
    for k, frame in enumerate(drive):
        frame.points.astype("<f4", copy=False).tofile(folder / "velodyne" / f"{k:06d}.bin")
        frame.labels.astype("<u4", copy=False).tofile(folder / "labels" / f"{k:06d}.label")
        points += len(frame.points)
        moving += int((to_classes(frame.labels) == MOVING).sum())
        report(k + 1)
    camera = CAMERA_FROM_LIDAR
    start, back = drive.poses[0], np.linalg.inv(camera)
    lines = (_matrix_line(camera @ relative_pose(start, pose) @ back) for pose in drive.poses)
    (folder / "poses.txt").write_text("".join(lines))
    projection = _matrix_line(np.array(((700.0, 0, 600, 0), (0, 700, 180, 0), (0, 0, 1, 0))))
    calibration = "".join(f"P{i}: {projection}" for i in range(4)) + f"Tr: {_matrix_line(camera)}"
    (folder / "calib.txt").write_text(calibration)
    (folder / "times.txt").write_text("".join(f"{time:.6e}\n" for time in drive.times))
    return np.array((points, moving))


def _matrix_line(matrix: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in matrix[:3].ravel()) + "\n"

"""Scans to measure on: a real sequence if one is given, else a simulated street."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from runtime.bundle.residual import Residual
from runtime.compute.workers import Workers
from runtime.image.entry import Entered
from runtime.image.inputs import InputBuilder
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import DEFAULT_SENSOR

T = TypeVar("T")
Frame = tuple[np.ndarray, np.ndarray]  # (N, 4) f32, (4, 4) T_world_lidar


def load_frames(sequence: Path | None, count: int, sensor: str = DEFAULT_SENSOR) -> list[Frame]:
    """The first `count` scans and poses; sensor: of a simulated street."""
    if sequence is None:
        from mos_model.simulator import simulate

        return [(frame.points, frame.pose) for frame in simulate(7, count, sensor)]
    from runtime.recordings.recording import Options
    from runtime.recordings.registry import open_recording

    return [(scan.data, scan.known_pose()) for scan in open_recording(sequence, Options(limit=count)).scans()]


def entered(scan: np.ndarray) -> Entered:
    """A scan as a runner takes it in."""
    return InputBuilder(RangeImage(), Residual(), Workers(1)).enter(scan)


def taking_part(scan: np.ndarray) -> np.ndarray:
    """Those points (N, 4) of it that a runner looks at."""
    inside = entered(scan)
    return inside.points[inside.takes_part]


def there_and_back(items: Sequence[T]) -> list[T]:
    """Forwards and backwards, the last and the first once: repeated, it never jumps."""
    return [*items, *items[-2:0:-1]]

"""Scans to measure on: a real sequence if one is given, else a simulated street."""

from pathlib import Path

import numpy as np

Frame = tuple[np.ndarray, np.ndarray]  # (N, 4) f32, (4, 4) T_world_lidar


def load_frames(sequence: Path | None, count: int) -> list[Frame]:
    """The first `count` scans and poses."""
    if sequence is None:
        from mos_model.simulator import simulate

        return [(frame.points, frame.pose) for frame in simulate(7, count)]
    from runtime.sequence import open_sequence

    opened = open_sequence(sequence)
    return [opened.read(i) for i in range(min(count, len(opened)))]

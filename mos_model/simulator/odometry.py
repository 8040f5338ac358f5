"""What an odometry makes of the true poses: drift from scan to scan, and jitter of each."""

import math
from random import Random

import numpy as np

from mos_model.simulator.rays import rotation


def true_pose(state: np.ndarray) -> np.ndarray:
    """(4, 4) T_world_lidar of a state (6,) x, y, z, yaw, pitch, roll."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(*state[3:]), state[:3]
    return pose


def draw_reported(rng: Random, poses: list[np.ndarray], strength: float) -> list[np.ndarray]:
    """Poses with the errors of an odometry: `strength` 0 none, 1 usual (some centimetre and 0.04 degrees)."""
    noise = np.random.default_rng(rng.getrandbits(32))
    jitter, tilt = strength * rng.uniform(0.003, 0.02), strength * math.radians(rng.uniform(0.01, 0.06))
    drift, swing = strength * rng.uniform(0.001, 0.01), strength * math.radians(rng.uniform(0.003, 0.02))
    wander, reported = np.eye(4), []
    for pose in poses:
        wander = wander @ _small(noise.normal(0, drift, 3), noise.normal(0, swing, 3))
        reported.append(pose @ wander @ _small(noise.normal(0, jitter, 3), noise.normal(0, tilt, 3)))
    return reported


def _small(shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A small rigid motion (4, 4)."""
    return true_pose(np.concatenate([shift, turn]))

"""Augmentation of one sample: a scan together with its past scans, their relative poses and its labels.

What moves the scan moves its past scans alike: with p' = A p for every scan, T_current_past becomes A T
inv(A), so the past scans may stay as they are when the input is built with A T instead. That is what
`Augmented.relative` is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from runtime.errors import SettingError

Points = NDArray[np.float32]


@dataclass(frozen=True)
class Augmentation:
    """What may happen to a sample. The defaults are the published augmentation (LMNet); the rest is off."""

    share: float = 0.5  # of the samples get the published augmentation
    chance: float = 0.5  # of each of its parts, then
    shift: tuple[float, float] = (5.0, 3.0)  # m, x and y, either way
    lower: float = 1.0  # m, down only
    flip: bool = True  # mirror y
    drop: float = 0.5  # largest share of the points that is dropped
    # from simulation to reality
    yaw: float = 0.0  # degrees, rotation about z, either way
    tilt: float = 0.0  # degrees, standard deviation of roll and pitch
    lift: float = 0.0  # m, sensor height, either way
    frame_chance: float = 0.0  # chance that points come in another frame than the sensor's, as that of a vehicle
    frame_tilt: float = 7.0  # degrees, roll and pitch of that frame, either way
    frame_lift: float = 1.0  # m, its height, either way
    pose_shift: float = 0.0  # m, standard deviation of the error of each odometry step, per axis
    pose_turn: float = 0.0  # degrees, the same of its rotation
    remission_off: float = 0.0  # chance that all remissions are 0
    remission_gain: float = 0.0  # standard deviation of the logarithm of their factor and of their exponent
    row_chance: float = 0.0  # chance that rows of the scan are missing
    row_share: float = 0.25  # largest share of them, then
    history_chance: float = 0.0  # chance that the oldest past scans are missing, as at the start of a drive

    def __post_init__(self) -> None:
        if len(self.shift) != 2:
            raise SettingError(f"augmentation shift must be two lengths, of x and y, not {self.shift!r}")
        for name in (
            "share",
            "chance",
            "drop",
            "remission_off",
            "row_chance",
            "row_share",
            "history_chance",
            "frame_chance",
        ):
            if not 0 <= getattr(self, name) <= 1:
                raise SettingError(f"augmentation {name} must lie within 0..1, not {getattr(self, name)!r}")
        for name in (
            "lower",
            "yaw",
            "tilt",
            "lift",
            "frame_tilt",
            "frame_lift",
            "pose_shift",
            "pose_turn",
            "remission_gain",
        ):
            if getattr(self, name) < 0:
                raise SettingError(f"augmentation {name} must not be negative, not {getattr(self, name)!r}")


NONE = Augmentation(share=0.0)
PAPER = Augmentation()
SIM2REAL = Augmentation(  # the simulator itself varies the mounting and errs in the poses
    yaw=20.0,
    tilt=0.5,
    lift=0.2,
    remission_off=0.25,
    remission_gain=0.4,
    row_chance=0.1,
    history_chance=0.1,
)
ANY_SENSOR = replace(SIM2REAL, frame_chance=0.2)


@dataclass(frozen=True)
class Augmented:
    """An augmented sample, new arrays where something changed."""

    points: Points  # (N', 4) f32 m and remission
    labels: NDArray[np.uint8]  # (N',) class of each point
    past: list[Points | None]  # scans 1, 2, ... steps back, each in its own frame, unmoved
    relative: list[NDArray[np.float64] | None]  # (4, 4), from the frame of the past scan to that of `points`


def augment(
    points: Points,
    labels: NDArray[np.uint8],
    past: Sequence[Points | None],
    relative: Sequence[NDArray[np.float64] | None],
    settings: Augmentation,
    rng: np.random.Generator,
) -> Augmented:
    """Augment a scan (N, 4) f32, its classes (N,) and its past scans with T_current_past, (4, 4) f64 each.

    No point may lie at the origin: moved, it would become a place.
    """
    published = rng.random() < settings.share
    transform = _draw_transform(settings, published, rng)
    past = _cut_history(past, settings, rng)
    relative = _disturb_poses(relative, settings, rng)
    if published and rng.random() < settings.chance and settings.drop:
        kept = 1 - settings.drop * rng.random()
        keep = rng.random(len(points), np.float32) < kept
        points, labels = points[keep], labels[keep]
        past = [scan if scan is None else scan[rng.random(len(scan), np.float32) < kept] for scan in past]
    if rng.random() < settings.row_chance:
        keep = _kept_rows(points, settings.row_share, rng)
        points, labels = points[keep], labels[keep]
    points = np.array(points, np.float32)
    points[:, 3] = _change_remission(points[:, 3], settings, rng)
    if not np.array_equal(transform, np.eye(4)):
        points[:, :3] = points[:, :3] @ transform[:3, :3].T.astype(np.float32) + transform[:3, 3].astype(np.float32)
    return Augmented(points, labels, past, [pose if pose is None else transform @ pose for pose in relative])


def rotation(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) Rz(yaw) Ry(pitch) Rx(roll), angles in radians."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _draw_transform(settings: Augmentation, published: bool, rng: np.random.Generator) -> NDArray[np.float64]:
    """The (4, 4) that moves every scan of the sample."""
    transform = np.eye(4)
    if settings.yaw or settings.tilt:
        roll, pitch = np.radians(settings.tilt) * rng.standard_normal(2)
        transform[:3, :3] = rotation(roll, pitch, math.radians(settings.yaw) * rng.uniform(-1, 1))
    transform[2, 3] = settings.lift * rng.uniform(-1, 1)
    if settings.frame_chance and rng.random() < settings.frame_chance:
        roll, pitch = np.radians(settings.frame_tilt) * rng.uniform(-1, 1, 2)
        transform[:3, :3] = rotation(0.5 * roll, pitch, 0.0) @ transform[:3, :3]
        transform[2, 3] += settings.frame_lift * rng.uniform(-1, 1)
    if published and rng.random() < settings.chance:
        transform[:2, 3] += np.array(settings.shift) * rng.uniform(-1, 1, 2)
        transform[2, 3] -= settings.lower * rng.random()
    if published and settings.flip and rng.random() < settings.chance:
        transform[1] *= -1
    return transform


def _cut_history(
    past: Sequence[Points | None], settings: Augmentation, rng: np.random.Generator
) -> list[Points | None]:
    if not past or rng.random() >= settings.history_chance:
        return list(past)
    length = int(rng.integers(len(past)))
    return [scan if i < length else None for i, scan in enumerate(past)]


def _disturb_poses(
    relative: Sequence[NDArray[np.float64] | None], settings: Augmentation, rng: np.random.Generator
) -> list[NDArray[np.float64] | None]:
    """Let odometry err at every step; the errors add up over the past."""
    if not settings.pose_shift and not settings.pose_turn:
        return list(relative)
    error = np.eye(4)
    disturbed: list[NDArray[np.float64] | None] = []
    for pose in relative:
        step = np.eye(4)
        step[:3, :3] = rotation(*(np.radians(settings.pose_turn) * rng.standard_normal(3)))
        step[:3, 3] = settings.pose_shift * rng.standard_normal(3)
        error = error @ step
        disturbed.append(pose if pose is None else error @ pose)
    return disturbed


def _kept_rows(points: Points, row_share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(N,) which points remain when some of 256 bands of elevation within +-32 degrees are missing."""
    flat = np.hypot(points[:, 0], points[:, 1])
    tangent = points[:, 2] / np.maximum(flat, np.float32(1e-6))
    band = np.clip((np.arctan(tangent) * np.float32(180 / math.pi / 0.25)).astype(np.int64) + 128, 0, 255)
    return (rng.random(256) >= row_share * rng.random())[band]


def _change_remission(remission: Points, settings: Augmentation, rng: np.random.Generator) -> NDArray[np.float32]:
    """Remission (N,) f32 in 0..1 of another sensor, or of none."""
    off = rng.random() < settings.remission_off
    factor, exponent = np.exp(settings.remission_gain * rng.standard_normal(2))
    if off:
        return np.zeros_like(remission)
    if not settings.remission_gain:
        return remission
    bent = np.float32(factor) * np.maximum(remission, 0) ** np.float32(exponent)
    clipped: NDArray[np.float32] = np.clip(bent, 0, 1)
    return clipped

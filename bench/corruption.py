"""Drives as people get them wrong: other units, axes, remissions and poses. Each takes and gives scans with poses."""

from collections.abc import Callable, Sequence

import numpy as np

from bench.mounting import turned
from bench.scans import Frame

Frames = list[Frame]
Change = Callable[[Frames], Frames]
Poses = np.ndarray  # (T, 4, 4)

CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # T_camera_lidar, axes only
FEET = 3.28  # in a metre


def as_it_is(frames: Frames) -> Frames:
    return frames


def remission(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda frames: [(np.column_stack([points[:, :3], change(points[:, 3])]), pose) for points, pose in frames]


def scaled(points: float = 1.0, poses: float = 1.0) -> Change:
    """Coordinates and positions times a factor each."""

    def change(frames: Frames) -> Frames:
        factors = np.array([points, points, points, 1], np.float32)
        return [(scan * factors, scaled_pose(pose, poses)) for scan, pose in frames]

    return change


def scaled_pose(pose: np.ndarray, factor: float) -> np.ndarray:
    scaled = pose.copy()
    scaled[:3, 3] *= factor
    return scaled


def seen_from(there: np.ndarray, poses: bool = True) -> Change:
    """Points in axes T_old_new; poses follow, or are still those of the old axes."""
    back = np.linalg.inv(there)
    return lambda frames: [(moved(points, back), pose @ there if poses else pose) for points, pose in frames]


def moved(points: np.ndarray, transform: np.ndarray) -> np.ndarray:
    xyz = points[:, :3] @ transform[:3, :3].T + transform[:3, 3]
    return np.column_stack([xyz, points[:, 3]]).astype(np.float32)


def posed(change: Callable[[Poses], Sequence[np.ndarray] | Poses]) -> Change:
    """Other poses for the same scans."""

    def changed(frames: Frames) -> Frames:
        poses = change(np.array([pose for _, pose in frames]))
        return [(points, pose) for (points, _), pose in zip(frames, poses, strict=True)]

    return changed


def shifted(by: int) -> Change:
    """Each scan takes the pose of `by` scans later."""
    return posed(lambda poses: poses[np.clip(np.arange(len(poses)) + by, 0, len(poses) - 1)])


def five_read_as_four(frames: Frames) -> Frames:
    """x y z remission ring, one after the other, cut into records of four."""
    found = []
    for points, pose in frames:
        records = np.insert(points, 4, np.arange(len(points)) % 64, axis=1).astype(np.float32).ravel()
        found.append((records[: len(records) // 4 * 4].reshape(-1, 4), pose))
    return found


def without_rotation(poses: Poses) -> Poses:
    found = poses.copy()
    found[:, :3, :3] = np.eye(3)
    return found


def transposed(poses: Poses) -> Poses:
    found = poses.copy()
    found[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    return found


def each_to_the_one_before(poses: Poses) -> Poses:
    return np.concatenate([np.eye(4)[None], np.linalg.inv(poses[:-1]) @ poses[1:]])


def in_world(frames: Frames) -> Frames:
    """Points where they are in the world."""
    return [(moved(points, pose), pose) for points, pose in frames]


def in_axes_of_world(frames: Frames) -> Frames:
    """Points from the sensor, in the world's axes."""
    return [(moved(points, scaled_pose(pose, 0)), pose) for points, pose in frames]


def map_coordinates(poses: Poses) -> Poses:
    there = turned(2, 77)
    there[:2, 3] = 5e6
    return there @ poses


def with_far_point(frames: Frames) -> Frames:
    return [(np.vstack([points, [[3e5, 0, 0, 0.5]]]).astype(np.float32), pose) for points, pose in frames]


def with_nan(frames: Frames) -> Frames:
    found = [(points.copy(), pose) for points, pose in frames]
    for points, _ in found:
        points[::50] = np.nan
    return found


# Every one of these makes the labels of a moving drive wrong, and must be warned of.
WRONG: dict[str, Change] = {
    "remission times 255": remission(lambda values: values * 255),
    "remission times 100": remission(lambda values: values * 100),
    "remission times 65535": remission(lambda values: values * 65535),
    "remission NaN": remission(lambda values: values * np.nan),
    "millimetres": scaled(1000),
    "millimetres, poses too": scaled(1000, 1000),
    "centimetres": scaled(100),
    "centimetres, poses too": scaled(100, 100),
    "decimetres, poses too": scaled(10, 10),
    "feet": scaled(FEET),
    "feet, poses too": scaled(FEET, FEET),
    "kilometres": scaled(0.001),
    "10 degrees down": seen_from(turned(1, 10)),
    "10 degrees up": seen_from(turned(1, -10)),
    "10 degrees down, poses not": seen_from(turned(1, 10), poses=False),
    "leaning 10 degrees": seen_from(turned(0, 10)),
    "upside down": seen_from(turned(0, 180)),
    "on its side": seen_from(turned(0, 90)),
    "x right, y down, z forward": seen_from(np.linalg.inv(CAMERA)),
    "x right, y forward, poses not": seen_from(turned(2, -90), poses=False),
    "5 columns read as 4": five_read_as_four,
    "identity poses": posed(lambda poses: np.broadcast_to(np.eye(4), poses.shape)),
    "relative poses": posed(each_to_the_one_before),
    "poses at half scale": scaled(poses=0.5),
    "poses at 0.8 of their scale": scaled(poses=0.8),
    "poses at double scale": scaled(poses=2),
    "poses in feet": scaled(poses=FEET),
    "poses in centimetres": scaled(poses=100),
    "inverted poses": posed(np.linalg.inv),
    "poses of a camera": posed(lambda poses: CAMERA @ poses @ np.linalg.inv(CAMERA)),
    "poses turned by 10 degrees on the sensor": posed(lambda poses: poses @ turned(2, 10)),
    "poses turned by 90 degrees on the sensor": posed(lambda poses: poses @ turned(2, 90)),
    "transposed rotations": posed(transposed),
    "no rotations": posed(without_rotation),
    "poses backwards": posed(lambda poses: poses[::-1]),
    "every second pose twice": posed(lambda poses: poses[np.arange(len(poses)) // 2 * 2]),
    "every second pose only": posed(lambda poses: poses[np.minimum(2 * np.arange(len(poses)), len(poses) - 1)]),
    "poses frozen after 5": posed(lambda poses: poses[np.minimum(np.arange(len(poses)), 5)]),
    "scans in the world": in_world,
    "scans in the world's axes": in_axes_of_world,
    "no points": lambda frames: [(points[:0], pose) for points, pose in frames],
}

# These cost no label, or hardly one: no word.
HARMLESS: dict[str, Change] = {
    "as it is": as_it_is,
    "no remission": lambda frames: [(points[:, :3], pose) for points, pose in frames],
    "remission 0": remission(lambda values: 0 * values),
    "x right, y forward": seen_from(turned(2, -90)),
    "map coordinates": posed(map_coordinates),
    "world of a camera": posed(lambda poses: CAMERA @ poses),
    "a point at 300 km": with_far_point,
    "every 50th point NaN": with_nan,
    "every 100th point": lambda frames: [(points[::100], pose) for points, pose in frames],
    "every other scan": lambda frames: frames[::2],
    "standing": lambda frames: [frames[0]] * len(frames),
}

"""A little street for tests: boxes and a ground, seen by a LiDAR that drives through it. NumPy only."""

from pathlib import Path

import numpy as np

# T_camera_lidar of KITTI's axes: the camera looks along x of the LiDAR, its x points right and its y down.
TR = np.array([[0.0, -1, 0, 0.02], [0, 0, -1, -0.06], [1, 0, 0, -0.3], [0, 0, 0, 1]])


def boxes(seed: int = 7) -> np.ndarray:
    """(B, 2, 3) lower and upper corners in m: houses with gaps, parked cars and poles along the x axis."""
    rng = np.random.default_rng(seed)
    found = []
    for side in (-1, 1):
        for x in np.arange(-60, 120, 9.0):
            width, depth, height = rng.uniform(4, 8), rng.uniform(2, 9), rng.uniform(2, 7)
            near = side * rng.uniform(6, 10)
            found.append([[x, min(near, near + side * depth), 0], [x + width, max(near, near + side * depth), height]])
            x0 = x + rng.uniform(0, 6)
            y0 = side * rng.uniform(3.5, 4.5)
            size = (4.2, 1.7, 1.5) if rng.random() < 0.5 else (0.3, 0.3, 5.0)
            found.append([[x0, y0 - size[1] / 2, 0], [x0 + size[0], y0 + size[1] / 2, size[2]]])
    return np.array(found)


def drive(count: int, step: float = 0.8, turn: float = 0.02) -> np.ndarray:
    """(count, 4, 4) T_world_lidar, 1.8 m above the ground: speeding up, winding left and right."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    x = y = yaw = 0.0
    for i in range(count):
        poses[i, :2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        poses[i, :3, 3] = x, y, 1.8
        speed = step * (1 + 0.5 * np.sin(i / 3))
        yaw += turn * np.sin(i / 2)
        x, y = x + speed * np.cos(yaw), y + speed * np.sin(yaw)
    return poses


def scan(
    pose: np.ndarray,
    world: np.ndarray,
    rows: int = 32,
    columns: int = 360,
    fov: tuple[float, float] = (2.0, -24.0),
) -> np.ndarray:
    """(N, 4) float32 x, y, z, remission in the LiDAR frame, ring by ring; rays that miss give none."""
    elevation = np.radians(np.linspace(*fov, rows))[:, None]
    azimuth = -2 * np.pi * (np.arange(columns) + 0.5)[None, :] / columns
    shape = (rows, columns)
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.broadcast_to(np.sin(elevation), shape),
        ],
        -1,
    ).reshape(-1, 3)
    directions = (rays @ pose[:3, :3].T).T
    origin = pose[:3, 3]
    with np.errstate(divide="ignore"):
        ground = np.where(directions[2] < 0, -origin[2] / directions[2], np.inf)
        distance = np.full(rows * columns, np.inf)
        for corners in world:
            slabs = (corners[:, :, None] - origin[:, None]) / directions
            enter, leave = slabs.min(0).max(0), slabs.max(0).min(0)
            distance = np.where((enter < leave) & (enter > 0) & (enter < distance), enter, distance)
    remission = np.where(ground < distance, 0.2, 0.4)
    distance = np.minimum(distance, ground)
    hit = distance < 80
    points = np.concatenate([rays * distance[:, None], remission[:, None]], 1)[hit]
    return points.astype(np.float32)


def write_kitti(folder: Path, count: int = 10, **options) -> Path:
    """A KITTI sequence folder of `count` scans: velodyne/, poses.txt in the camera frame, calib.txt."""
    world, poses = boxes(), drive(count)
    (folder / "velodyne").mkdir(parents=True)
    for i, pose in enumerate(poses):
        scan(pose, world, **options).tofile(folder / "velodyne" / f"{i:06d}.bin")
    write_camera_poses(folder, poses)
    return folder


def write_camera_poses(folder: Path, poses: np.ndarray) -> None:
    """poses.txt in the camera frame and calib.txt, of T_world_lidar (T, 4, 4)."""
    write_poses(folder / "poses.txt", TR @ np.linalg.inv(poses[0]) @ poses @ np.linalg.inv(TR))
    (folder / "calib.txt").write_text("P0: " + " ".join(["0"] * 12) + "\nTr: " + _row(TR) + "\n")


def write_poses(path: Path, poses: np.ndarray) -> None:
    """KITTI's text form, 12 numbers a line."""
    path.write_text("".join(_row(pose) + "\n" for pose in poses))


def _row(pose: np.ndarray) -> str:
    return " ".join(f"{value:.9e}" for value in pose[:3].ravel())

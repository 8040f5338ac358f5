"""Naive references of the simulator's ray casting: march along each ray and ask whether the point is inside."""

import numpy as np

from mos_model.simulator.raycast import ELLIPSOID, FRUSTUM


def inside(row: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) in the world lie in the primitive `row`."""
    x, y, z = (points - row[1:4]).T
    x, y = row[4] * x + row[5] * y, row[4] * y - row[5] * x
    g = row[6:14]
    if row[0] == FRUSTUM:
        u = (z - g[0]) / (g[1] - g[0])
        rear, front, half = g[2] + u * (g[4] - g[2]), g[3] + u * (g[5] - g[3]), g[6] + u * (g[7] - g[6])
        return (u >= 0) & (u <= 1) & (x >= rear) & (x <= front) & (np.abs(y) <= half)
    local = np.stack([x, y, z], 1)
    if row[0] == ELLIPSOID:
        return (((local - g[:3]) / g[3:6]) ** 2).sum(1) <= 1
    a, b = g[:3], g[3:6]
    u = np.clip((local - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(local - a - u[:, None] * (b - a), axis=1) <= g[6]


def first_hits(prims: np.ndarray, origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
    """Depth (n,) at which each ray is first inside a primitive, to a millimetre; inf where never before `reach` m.
    Steps of 3 cm, so a ray may pass through a thinner edge."""

    def any_inside(rays: np.ndarray, t: np.ndarray) -> np.ndarray:
        points = origins[rays] + t[:, None] * directions[rays]
        return np.logical_or.reduce([inside(row, points) for row in prims])

    depth, left = np.full(len(origins), np.inf), np.arange(len(origins))
    for t in np.arange(0.3, reach, 0.03):
        hit = any_inside(left, np.full(len(left), t))
        depth[left[hit]] = t
        left = left[~hit]
    found = np.flatnonzero(np.isfinite(depth))
    low, high = depth[found] - 0.03, depth[found]
    for _ in range(6):
        middle = 0.5 * (low + high)
        hit = any_inside(found, middle)
        low, high = np.where(hit, low, middle), np.where(hit, middle, high)
    depth[found] = high
    return depth

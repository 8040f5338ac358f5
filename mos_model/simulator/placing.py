"""Kernels about where things stand: put shapes into the world, keep its floor plan, find what is near."""

import numpy as np

from mos_model.simulator.raycast import CAPSULE, CLOTH
from runtime.compute.jit import kernel


@kernel
def place(templates, pose, walked, vigour, out, first):  # type: ignore[no-untyped-def]
    """Write `templates` (n, COLUMNS), see `raycast`, into `out` from row `first`, moved by `pose` (x, y, z,
    yaw), with limbs swung after `walked` metres, `vigour` 0 to 1 times as far. A rod of cloth with parameters
    [1, bend rad, fixed rad] hangs on the end of the row before, bent by `fixed`, and by `bend` while it comes
    forward."""
    c, s = np.cos(pose[3]), np.sin(pose[3])
    for k in range(len(templates)):
        row, t = out[first + k], templates[k]
        for i in range(len(t)):
            row[i] = t[i]
        row[1] = pose[0] + c * t[1] - s * t[2]
        row[2] = pose[1] + s * t[1] + c * t[2]
        row[3] = pose[2] + t[3]
        row[4] = c * t[4] - s * t[5]
        row[5] = s * t[4] + c * t[5]
        jointed = t[0] == CAPSULE and t[14] == CLOTH and t[16] != 0.0
        if t[19] == 0.0 and not jointed:
            continue
        # The second end of a rod swings about the first, in the x-z plane.
        phase = 2.0 * np.pi * walked / t[20] + t[21]
        angle = vigour * t[19] * np.sin(phase)
        dx, dz = t[9] - t[6], t[11] - t[8]
        x, z = t[6], t[8]
        if jointed:  # the first end is the second of the row before; it bends while the limb comes forward
            side = 1.0 if t[19] > 0.0 else -1.0
            angle += t[18] + vigour * t[17] * max(side * np.cos(phase + 0.5), 0.0)
            x, z = out[first + k - 1, 9], out[first + k - 1, 11]
            row[6], row[8] = x, z
        row[9] = x + np.cos(angle) * dx - np.sin(angle) * dz
        row[11] = z + np.sin(angle) * dx + np.cos(angle) * dz


@kernel
def claim(taken, x0, y0, cell, x, y, yaw, rear, front, half, mark):  # type: ignore[no-untyped-def]
    """Whether the rectangle at (x, y, yaw), `rear` to `front` m along and `half` m to both sides, is free in
    the grid `taken` (rows, columns) bool with its corner at (x0, y0); if so and `mark`, take it."""
    c, s = np.cos(yaw), np.sin(yaw)
    na, nb = int((front - rear) / cell) + 1, int(2.0 * half / cell) + 1
    for turn in range(2 if mark else 1):
        for a in range(na + 1):
            for b in range(nb + 1):
                lx, ly = rear + (front - rear) * a / na, -half + 2.0 * half * b / nb
                j, i = int((x + c * lx - s * ly - x0) / cell), int((y + s * lx + c * ly - y0) / cell)
                if i < 0 or j < 0 or i >= taken.shape[0] or j >= taken.shape[1]:
                    return False
                if turn == 0 and taken[i, j]:
                    return False
                if turn == 1:
                    taken[i, j] = True
    return True


@kernel
def distances(prims, boxes, x, y):  # type: ignore[no-untyped-def]
    """Distances (n,) of the boxes of the primitives from (x, y), in the plane, m."""
    out = np.empty(len(prims))
    for k in range(len(prims)):
        c, s = prims[k, 4], prims[k, 5]
        dx, dy = x - prims[k, 1], y - prims[k, 2]
        lx, ly = c * dx + s * dy, c * dy - s * dx
        gx = max(boxes[k, 0] - lx, 0.0, lx - boxes[k, 3])
        gy = max(boxes[k, 1] - ly, 0.0, ly - boxes[k, 4])
        out[k] = np.sqrt(gx * gx + gy * gy)
    return out


@kernel
def clearance(prims, boxes, spots):  # type: ignore[no-untyped-def]
    """Least distance, in the plane, m, of `spots` (n, 3) x, y and height of the ground from whatever of the primitives
    is at the height of a body there; 9 where nothing is near."""
    middle_x, middle_y = 0.5 * (spots[0, 0] + spots[-1, 0]), 0.5 * (spots[0, 1] + spots[-1, 1])
    reach = 0.0
    for i in range(len(spots)):
        reach = max(reach, np.hypot(spots[i, 0] - middle_x, spots[i, 1] - middle_y))
    least = 9.0
    for k in range(len(prims)):
        c, s = prims[k, 4], prims[k, 5]
        dx, dy = middle_x - prims[k, 1], middle_y - prims[k, 2]
        lx, ly = c * dx + s * dy, c * dy - s * dx
        gx = max(boxes[k, 0] - lx, 0.0, lx - boxes[k, 3])
        gy = max(boxes[k, 1] - ly, 0.0, ly - boxes[k, 4])
        if gx * gx + gy * gy > (reach + least) ** 2:
            continue
        for i in range(len(spots)):
            floor = spots[i, 2] - prims[k, 3]
            if boxes[k, 2] > floor + 1.8 or boxes[k, 5] < floor + 0.2:
                continue
            dx, dy = spots[i, 0] - prims[k, 1], spots[i, 1] - prims[k, 2]
            lx, ly = c * dx + s * dy, c * dy - s * dx
            gx = max(boxes[k, 0] - lx, 0.0, lx - boxes[k, 3])
            gy = max(boxes[k, 1] - ly, 0.0, ly - boxes[k, 4])
            least = min(least, np.sqrt(gx * gx + gy * gy))
    return least

"""The rays of one sweep: where each firing starts, where it points, and when. Kernels."""

import numpy as np

from runtime.compute.jit import kernel


@kernel
def firing_ticks(steps, encoder, phase):  # type: ignore[no-untyped-def]
    """Azimuth of each firing, (steps,) radians in 0..2 pi from forward to the left, on the encoder's grid."""
    azimuth = np.empty(steps)
    ticks = encoder if encoder > 0 else steps
    for k in range(steps):
        position = (k + phase) * ticks / steps
        azimuth[k] = np.floor(position) * 2.0 * np.pi / ticks
    return azimuth


@kernel
def rotation(yaw, pitch, roll):  # type: ignore[no-untyped-def]
    """Rotation matrix Rz(yaw) @ Ry(pitch) @ Rx(roll), (3, 3)."""
    cy, sy, cp, sp, cr, sr = (
        np.cos(yaw),
        np.sin(yaw),
        np.cos(pitch),
        np.sin(pitch),
        np.cos(roll),
        np.sin(roll),
    )
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    out[1, 0], out[1, 1], out[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    out[2, 0], out[2, 1], out[2, 2] = -sp, cp * sr, cp * cr
    return out


@kernel
def local_rays(azimuth, elevation, offset):  # type: ignore[no-untyped-def]
    """Directions in the sensor frame, (columns, beams, 3) float32; `offset` (beams,) radians turns beams."""
    columns, beams = len(azimuth), len(elevation)
    out = np.empty((columns, beams, 3), np.float32)
    up, flat = np.sin(elevation), np.cos(elevation)
    co, so = np.cos(offset), np.sin(offset)
    for c in range(columns):
        ca, sa = np.cos(azimuth[c]), np.sin(azimuth[c])
        for b in range(beams):
            out[c, b, 0] = flat[b] * (ca * co[b] - sa * so[b])
            out[c, b, 1] = flat[b] * (sa * co[b] + ca * so[b])
            out[c, b, 2] = up[b]
    return out


@kernel
def world_rays(local, azimuth, states, world, slope, origin, level, phase):  # type: ignore[no-untyped-def]
    """Turn the rays of one sweep into the world.

    `states` (3, 6): x, y, z, yaw, pitch, roll of the sensor at the start, middle and end of the sweep. Fills
    `world` (columns, beams, 3) unit directions, `slope` (columns, beams) rise per horizontal metre, `origin`
    (columns, 3), `level` (columns, 3): horizontal unit direction and slope of a ray of elevation 0, and
    `phase` (columns,): time in the sweep, -0.5 to 0.5 of its duration. The sweep begins and ends behind the
    sensor.
    """
    columns, beams = local.shape[0], local.shape[1]
    state = np.empty(6)
    for c in range(columns):
        turn = azimuth[c] / (2.0 * np.pi)
        time = turn if turn < 0.5 else turn - 1.0
        phase[c] = time
        k = 0 if time < 0.0 else 1
        weight = 2.0 * time + 1.0 if time < 0.0 else 2.0 * time
        for i in range(6):
            state[i] = states[k, i] + weight * (states[k + 1, i] - states[k, i])
        r = rotation(state[3], state[4], state[5])
        for i in range(3):
            origin[c, i] = state[i]
        x, y = np.cos(azimuth[c]), np.sin(azimuth[c])
        fx, fy, fz = r[0, 0] * x + r[0, 1] * y, r[1, 0] * x + r[1, 1] * y, r[2, 0] * x + r[2, 1] * y
        flat = np.sqrt(fx * fx + fy * fy)
        level[c, 0], level[c, 1], level[c, 2] = fx / flat, fy / flat, fz / flat
        for b in range(beams):
            x, y, z = local[c, b, 0], local[c, b, 1], local[c, b, 2]
            wx = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z
            wy = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z
            wz = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z
            world[c, b, 0], world[c, b, 1], world[c, b, 2] = wx, wy, wz
            slope[c, b] = wz / np.sqrt(wx * wx + wy * wy)


@kernel
def restoring(states, phase):  # type: ignore[no-untyped-def]
    """(columns, 3, 4) motions that take what was measured at each column to the sensor's frame at mid-sweep,
    for a sensor that moved as `states` (see world_rays) say."""
    middle = rotation(states[1, 3], states[1, 4], states[1, 5])
    out = np.empty((len(phase), 3, 4))
    state = np.empty(6)
    for c in range(len(phase)):
        k = 0 if phase[c] < 0.0 else 1
        weight = 2.0 * phase[c] + 1.0 if phase[c] < 0.0 else 2.0 * phase[c]
        for i in range(6):
            state[i] = states[k, i] + weight * (states[k + 1, i] - states[k, i])
        turn = rotation(state[3], state[4], state[5])
        for i in range(3):
            for j in range(3):
                out[c, i, j] = middle[0, i] * turn[0, j] + middle[1, i] * turn[1, j] + middle[2, i] * turn[2, j]
            out[c, i, 3] = 0.0
            for j in range(3):
                out[c, i, 3] += middle[j, i] * (state[j] - states[1, j])
    return out

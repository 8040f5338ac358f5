"""Rays against primitives: each primitive is tested only with the rays inside its outline, near ones first,
and the nearest hit of each ray is kept. Kernels; one file, self-contained.

A primitive is one row of COLUMNS float64 values:
    0 kind; 1-3 position of its own frame in the world; 4, 5 cosine and sine of its yaw; 6-13 geometry;
    14 material; 15 object; 16-18 parameters of the material; 19-21 swing of a limb (rad, stride m, phase); 22 albedo
Geometry, m, in its own frame:
    FRUSTUM    z bottom, z top, x rear and x front at the bottom, the same at the top, half width bottom, top
    ELLIPSOID  centre x y z, radii x y z
    CAPSULE    end point, end point, radius
"""

import numpy as np

from runtime.compute.jit import fast_kernel, inlined, kernel

COLUMNS = 23
FRUSTUM, ELLIPSOID, CAPSULE = 0, 1, 2
# Materials; parameters in brackets.
MATT = 0
FACADE = 1  # wall with windows [period m, glazed share 0..1, recess m]
BARS = 2  # fence of bars along x [period m, share that is solid]
MESH = 3  # anything a ray passes by chance [chance to be stopped]
FOLIAGE = 4  # leaves in the volume [hits per metre where dense, cell m, dense share 0..1]
PAINT = 5  # car body [gloss 0..1: share of the light mirrored away where it does not fall straight on]
CABIN = 6  # car body with windows [window bottom m, window top m, chance to be stopped by the glass]
CLOTH = 7
METAL = 8

FREE_PATHS = -np.log((np.arange(1024) + 0.5) / 1024.0)  # quantiles of the way to the next leaf, in mean ways


@inlined
def _next(state):  # type: ignore[no-untyped-def]
    s = state[0]
    s ^= s << np.uint64(13)
    s ^= s >> np.uint64(7)
    s ^= s << np.uint64(17)
    state[0] = s
    return s


@inlined
def _uniform(state):  # type: ignore[no-untyped-def]
    return np.int64(_next(state) >> np.uint64(40)) * (1.0 / 16777216.0)


@inlined
def _cell_hash(i, j, k, salt):  # type: ignore[no-untyped-def]
    h = np.uint64(i * 73856093) ^ np.uint64(j * 19349663) ^ np.uint64(k * 83492791) ^ np.uint64(salt * 2654435761)
    h ^= h >> np.uint64(31)
    h *= np.uint64(0x9E3779B97F4A7C15)
    h ^= h >> np.uint64(29)
    return np.int64(h >> np.uint64(40)) * (1.0 / 16777216.0)


@fast_kernel
def _frustum(g, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Entry, exit, entry face (0 x, 1 y, 2 z) and cosine of incidence there; entry > exit: missed."""
    high = g[1] - g[0]
    kr, kf, kw = (g[4] - g[2]) / high, (g[5] - g[3]) / high, (g[7] - g[6]) / high
    near, far, face, cosine = -1e9, 1e9, 2, 0.0
    z = oz - g[0]
    for p in range(6):
        if p == 0:
            nd, no, length, f = dz, high - z, 1.0, 2
        elif p == 1:
            nd, no, length, f = -dz, z, 1.0, 2
        elif p == 2:
            nd, no, length, f = dx - kf * dz, g[3] + kf * z - ox, 1.0 + kf * kf, 0
        elif p == 3:
            nd, no, length, f = kr * dz - dx, ox - g[2] - kr * z, 1.0 + kr * kr, 0
        elif p == 4:
            nd, no, length, f = dy - kw * dz, g[6] + kw * z - oy, 1.0 + kw * kw, 1
        else:
            nd, no, length, f = -dy - kw * dz, g[6] + kw * z + oy, 1.0 + kw * kw, 1
        if nd < -1e-12:
            t = no / nd
            if t > near:
                near, face, cosine = t, f, -nd / np.sqrt(length)
        elif nd > 1e-12:
            far = min(far, no / nd)
        elif no < 0.0:
            far = -1e9
    return near, far, face, cosine


@fast_kernel
def _ellipsoid(g, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    ax, ay, az = (ox - g[0]) / g[3], (oy - g[1]) / g[4], (oz - g[2]) / g[5]
    bx, by, bz = dx / g[3], dy / g[4], dz / g[5]
    a, b, c = bx * bx + by * by + bz * bz, ax * bx + ay * by + az * bz, ax * ax + ay * ay + az * az - 1.0
    under = b * b - a * c
    near, far, cosine = 1e9, -1e9, 0.0
    if under > 0.0:
        root = np.sqrt(under)
        near, far = (-b - root) / a, (-b + root) / a
        cosine = min(root / np.sqrt(a), 1.0)
    return near, far, 2, cosine


@fast_kernel
def _capsule(g, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    px, py, pz = g[3] - g[0], g[4] - g[1], g[5] - g[2]
    qx, qy, qz = ox - g[0], oy - g[1], oz - g[2]
    pp, pd, pq = px * px + py * py + pz * pz, px * dx + py * dy + pz * dz, px * qx + py * qy + pz * qz
    qd, qq = qx * dx + qy * dy + qz * dz, qx * qx + qy * qy + qz * qz
    a, b, c = pp - pd * pd, pp * qd - pq * pd, pp * qq - pq * pq - g[6] * g[6] * pp
    under = b * b - a * c
    near, cosine, t = 1e9, 0.0, 0.0
    if under >= 0.0 and a > 1e-12:
        t = (-b - np.sqrt(under)) / a
        along = pq + t * pd
        if 0.0 < along < pp:
            near = t
        else:  # the cap
            if along >= pp:
                qx, qy, qz = qx - px, qy - py, qz - pz
            b, c = qx * dx + qy * dy + qz * dz, qx * qx + qy * qy + qz * qz - g[6] * g[6]
            under = b * b - c
            if under > 0.0:
                near = -b - np.sqrt(under)
        cosine = np.sqrt(max(under, 0.0)) / (np.sqrt(a * pp) * g[6] + 1e-9) if near == t else 0.7
    return near, near + 2.0 * g[6] if near < 1e8 else -1e9, 2, min(cosine, 1.0)


@fast_kernel
def _material(row, k, near, far, face, ox, oy, oz, dx, dy, dz, limit, cosine, state):  # type: ignore[no-untyped-def]
    """What the material makes of a ray that enters at `near`: (depth, hit, cosine); inf: the ray goes on."""
    material = int(row[14])
    hit = k
    if material == FOLIAGE:
        t = max(near, 0.3)
        end = min(far, limit)
        free, fine = 1.0 / row[16], 1.0 / row[17]
        while True:
            t += FREE_PATHS[np.int64(_next(state) >> np.uint64(54))] * free
            if t >= end:
                return np.inf, hit, 0.0
            i = int(np.floor((ox + t * dx) * fine))
            j = int(np.floor((oy + t * dy) * fine))
            n = int(np.floor((oz + t * dz) * fine))
            if _cell_hash(i, j, n, k) < row[18]:
                return t, hit, 0.3 + 0.7 * _uniform(state)
    if near < 0.3 or near >= limit:
        return np.inf, hit, 0.0
    if material == FACADE and face != 2:
        u = (oy + near * dy) if face == 0 else (ox + near * dx)
        z = oz + near * dz
        i, j = np.floor(u / row[16]), np.floor(z / 3.0)
        fu, fz = u / row[16] - i, z / 3.0 - j
        if abs(fu - 0.5) < 0.5 * row[17] and 0.28 < fz < 0.78:
            style = _cell_hash(int(i), int(j), face, k)
            near += row[18] * (0.4 + 0.6 * style) / max(cosine, 0.2)
            if style < 0.7:  # glass: most of the light goes in or is mirrored away, more of it in some panes
                chance = _uniform(state)
                if chance < 3.0 * abs(style - 0.35) * (1.3 - 0.6 * cosine):
                    hit = -1
                elif chance > 0.9:
                    near += 0.5 + 3.0 * _uniform(state)
    elif material == BARS:
        w = (ox + near * dx + 0.02 * (_uniform(state) - 0.5)) / row[16]
        if w - np.floor(w) > row[17]:
            return np.inf, hit, 0.0
    elif material == PAINT:
        u = (oy + near * dy) if face == 0 else (ox + near * dx)
        patch = _cell_hash(int(np.floor(u * 2.0)), int(np.floor((oz + near * dz) * 8.0)), face, k)
        if _uniform(state) < (0.85 if patch < row[16] * (1.35 - cosine) else 0.1 * row[16]):
            hit = -1
    elif material == MESH:
        if _uniform(state) > row[16]:
            return np.inf, hit, 0.0
    elif material == CABIN and face != 2:
        z = oz + near * dz
        if row[16] < z < row[17]:
            u = (oy + near * dy) if face == 0 else (ox + near * dx)
            pane = _cell_hash(int(np.floor(u * 3.0)), int(np.floor(z * 4.0)), face, k) < row[18]
            if _uniform(state) > (0.9 if pane else 0.12):
                if _uniform(state) < 0.3:
                    near += min(0.2 + 1.5 * _uniform(state), 0.8 * (far - near))  # seats
                else:
                    hit = -1
    if near >= limit:
        return np.inf, hit, 0.0
    return near, hit, cosine


@kernel
def _outline(row, box, velocity, states, duration, columns):  # type: ignore[no-untyped-def]
    """First and last column that may see the box in the sweep; `columns` apart: all of them."""
    first, last, reference = 1e9, -1e9, 1e9
    for k in range(3):
        time = 0.5 * (k - 1) * duration
        dx = states[k, 0] - velocity[0] * time - row[1]
        dy = states[k, 1] - velocity[1] * time - row[2]
        c, s = row[4], row[5]
        lx, ly = c * dx + s * dy, c * dy - s * dx
        if box[0] - 0.4 < lx < box[3] + 0.4 and box[1] - 0.4 < ly < box[4] + 0.4:
            return 0, columns
        turn = np.arctan2(s, c) - states[k, 3]
        middle = np.arctan2(0.5 * (box[1] + box[4]) - ly, 0.5 * (box[0] + box[3]) - lx)
        if reference > 1e8:
            reference = middle + turn
        shift = middle + turn - reference
        shift -= 2.0 * np.pi * np.round(shift / (2.0 * np.pi))
        for corner in range(4):
            x = (box[0] if corner % 2 else box[3]) - lx
            y = (box[1] if corner < 2 else box[4]) - ly
            a = np.arctan2(y, x) - middle
            a += shift - 2.0 * np.pi * np.round(a / (2.0 * np.pi))
            first, last = min(first, a), max(last, a)
    scale = columns / (2.0 * np.pi)
    margin = 4.0  # columns: beams stand beside the column's own azimuth, and tilt turns them further
    low = int(np.floor((reference + first) * scale - margin))
    high = int(np.ceil((reference + last) * scale + margin))
    return low, min(high, low + columns)


@fast_kernel
def cast_primitives(  # type: ignore[no-untyped-def]
    prims, boxes, order, velocity, world, slope, origin, level, phase, drop, tangents, states, duration, seed,
    depth, hit, cosine,
):  # fmt: skip
    """Lower `depth` (columns, beams) to the nearest primitive of each ray; `hit` is its row, -1 where the
    light is lost; `cosine` that of incidence. `order` (k,) the rows to test, near ones first; `velocity`
    (objects, 2) m/s; `tangents` (beams,) falling slopes in a level sensor; the rest as world_rays gives it."""
    columns, beams = depth.shape
    state = np.empty(1, np.uint64)
    state[0] = np.uint64(seed) | np.uint64(1)
    lowest, highest = np.max(drop), np.min(drop)
    bins = 255.0 / (tangents[0] - tangents[beams - 1])
    row_of = np.zeros(256, np.int64)  # first row at or below a slope
    for i in range(256):
        row_of[i] = row_of[i - 1] if i else 0
        while tangents[row_of[i]] > tangents[0] - i / bins and row_of[i] < beams - 1:
            row_of[i] += 1
    for index in range(len(order)):
        k = order[index]
        row, box, g = prims[k], boxes[k], prims[k, 6:14]
        v = velocity[int(row[15])]
        low, high = _outline(row, box, v, states, duration, columns)
        c4, s4 = row[4], row[5]
        kind = int(row[0])
        for column in range(low, high):
            c = column % columns
            time = phase[c] * duration
            px, py = origin[c, 0] - v[0] * time - row[1], origin[c, 1] - v[1] * time - row[2]
            ox, oy, oz = c4 * px + s4 * py, c4 * py - s4 * px, origin[c, 2] - row[3]
            hx, hy = c4 * level[c, 0] + s4 * level[c, 1], c4 * level[c, 1] - s4 * level[c, 0]
            # Horizontal distance at which the column enters and leaves the box, a little enlarged.
            grow = 0.02 + 0.012 * np.sqrt(px * px + py * py)
            if abs(hx) < 1e-9:
                hx = 1e-9
            if abs(hy) < 1e-9:
                hy = 1e-9
            a, b = (box[0] - grow - ox) / hx, (box[3] + grow - ox) / hx
            d, e = (box[1] - grow - oy) / hy, (box[4] + grow - oy) / hy
            enter, leave = max(min(a, b), min(d, e), 0.3), min(max(a, b), max(d, e))
            if enter >= leave:
                continue
            # Slopes from which it is seen there, then rows.
            top, bottom = box[5] - oz + lowest + 0.02, box[2] - oz + highest - 0.02
            top = top / enter if top > 0.0 else top / leave
            bottom = bottom / enter if bottom < 0.0 else bottom / leave
            top, bottom = top - level[c, 2] + 0.01, bottom - level[c, 2] - 0.01
            if top < tangents[beams - 1] or bottom > tangents[0]:
                continue
            first = row_of[int((tangents[0] - top) * bins)] if top < tangents[0] else 0
            for b in range(first, beams):
                if tangents[b] < bottom:
                    break
                if depth[c, b] <= enter:
                    continue
                wx, wy, dz = world[c, b, 0], world[c, b, 1], world[c, b, 2]
                dx, dy = c4 * wx + s4 * wy, c4 * wy - s4 * wx
                z = oz - drop[b]
                if kind == FRUSTUM:
                    near, far, face, angle = _frustum(g, ox, oy, z, dx, dy, dz)
                elif kind == ELLIPSOID:
                    near, far, face, angle = _ellipsoid(g, ox, oy, z, dx, dy, dz)
                else:
                    near, far, face, angle = _capsule(g, ox, oy, z, dx, dy, dz)
                if near > far or far < 0.0 or near >= depth[c, b]:
                    continue
                t, what, angle = _material(row, k, near, far, face, ox, oy, z, dx, dy, dz, depth[c, b], angle, state)
                if t < depth[c, b]:
                    depth[c, b], hit[c, b], cosine[c, b] = t, what, angle

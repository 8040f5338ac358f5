"""Firings that end in the air: in fog, drops, flakes, clouds of dust and spray. Kernels; one file, self-contained."""

import numpy as np

from runtime.compute.jit import fast_kernel, inlined

AIR = -7  # what `hit` says of a firing that ended in the air (see `returns`)
WAYS = -np.log((np.arange(1024) + 0.5) / 1024.0)  # quantiles of an exponential distribution, mean 1
SAME = 0.7  # about their median


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
def _thickness(field, fine, x, y, z):  # type: ignore[no-untyped-def]
    last = field.shape[0] - 1  # the length is a power of two
    return field[int(np.floor(x * fine)) & last, int(np.floor(y * fine)) & last, int(np.floor(z * fine)) & last]


@fast_kernel
def cast_haze(  # type: ignore[no-untyped-def]
    world, origin, drop, field, cell, drift, share, gain, near, scale, reach, outshone, surface, seed,
    depth, hit, cosine,
):  # fmt: skip
    """Let firings end in the air before their target: `depth`, `hit` and `cosine` (columns, beams) change there.

    A firing with nothing behind meets the air with chance `share`; a target at t m outshines the air but for a
    chance of t^2 / (t^2 + outshone^2). It ends where it has passed enough of it from `near` m on, within `reach` m:
    on average as much as lies on `scale` m, exponentially distributed at `surface` 0, so that it ends anywhere, and
    always the same at 1, so that thick air looks like a surface. `gain` (beams,) multiplies both. Thickness: `field`
    (n, n, n) of mean 1, n a power of two, cells of `cell` m, repeated over the world and moved by `drift` (3,) m.
    Rays as world_rays gives them.
    """
    columns, beams = depth.shape
    state = np.empty(1, np.uint64)
    state[0] = np.uint64(seed) | np.uint64(1)
    fine, dark = 1.0 / cell, outshone * outshone
    for c in range(columns):
        ox, oy, oz = origin[c, 0] - drift[0], origin[c, 1] - drift[1], origin[c, 2] - drift[2]
        for b in range(beams):
            chance, end = share * gain[b], reach
            if hit[c, b] != -1 and depth[c, b] < 1e8:
                t = np.float64(depth[c, b])
                chance *= t * t / (t * t + dark)
                end = min(end, t)
            if _uniform(state) >= chance:
                continue
            left = (1.0 - surface) * WAYS[np.int64(_next(state) >> np.uint64(54))] + SAME * surface
            left *= scale / gain[b]
            r, dx, dy, dz = near, world[c, b, 0], world[c, b, 1], world[c, b, 2]
            while r < end:
                step = 0.15 + 0.15 * r
                m = r + 0.5 * step
                thickness = _thickness(field, fine, ox + m * dx, oy + m * dy, oz - drop[b] + m * dz)
                if thickness * step >= left:
                    r += left / thickness
                    if r < end:
                        depth[c, b], hit[c, b], cosine[c, b] = r, AIR, _uniform(state)
                    break
                left -= thickness * step
                r += step


@fast_kernel
def cast_puffs(  # type: ignore[no-untyped-def]
    world, origin, level, drop, puffs, field, cell, drift, near, seed, depth, hit, cosine
):  # fmt: skip
    """Let firings end in small clouds: `puffs` (n, 5) x, y, z of the centre m, radius m, chance 0..1 of a firing
    to end in it on its way through the middle, in air of mean thickness. The rest as in `cast_haze`."""
    columns, beams = depth.shape
    state = np.empty(1, np.uint64)
    state[0] = np.uint64(seed) | np.uint64(1)
    fine = 1.0 / cell
    for p in range(len(puffs)):
        radius = puffs[p, 3]
        for c in range(columns):
            qx, qy, height = puffs[p, 0] - origin[c, 0], puffs[p, 1] - origin[c, 1], puffs[p, 2] - origin[c, 2]
            ahead, aside = level[c, 0] * qx + level[c, 1] * qy, level[c, 0] * qy - level[c, 1] * qx
            wide = radius + 0.05 * abs(ahead)  # beams stand beside the column's own azimuth
            if ahead < -wide or abs(aside) > wide:
                continue
            for b in range(beams):
                dx, dy, dz, qz = world[c, b, 0], world[c, b, 1], world[c, b, 2], height + drop[b]
                along = qx * dx + qy * dy + qz * dz
                square = radius * radius - (qx * qx + qy * qy + qz * qz - along * along)
                if square <= 0.0:
                    continue
                half = np.sqrt(square)
                enter, leave = max(along - half, near), along + half
                if leave <= enter or enter >= depth[c, b]:
                    continue
                u = _uniform(state)
                chance = puffs[p, 4] * (leave - enter) / (2.0 * radius)
                if u >= chance:
                    continue
                r = enter + (leave - enter) * _uniform(state) * _uniform(state)
                if r >= depth[c, b]:
                    continue
                x, y = origin[c, 0] - drift[0] + r * dx, origin[c, 1] - drift[1] + r * dy
                z = origin[c, 2] - drift[2] - drop[b] + r * dz
                if u < chance * _thickness(field, fine, x, y, z):
                    depth[c, b], hit[c, b], cosine[c, b] = r, AIR, _uniform(state)

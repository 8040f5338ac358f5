"""Firings that end in the air: in fog, drops, flakes, clouds of dust and spray. Kernels; one file, self-contained."""

import numpy as np

from runtime.compute.jit import fast_kernel, inlined

AIR = -7  # what `hit` says of a firing that ended in the air (see `returns`)
WAYS = -np.log((np.arange(1024) + 0.5) / 1024.0)  # quantiles of an exponential distribution, mean 1


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
    n = field.shape[0]
    return field[int(np.floor(x * fine)) % n, int(np.floor(y * fine)) % n, int(np.floor(z * fine)) % n]


@fast_kernel
def cast_haze(  # type: ignore[no-untyped-def]
    world, origin, drop, field, cell, drift, share, gain, near, scale, reach, outshone, seed, depth, hit, cosine
):  # fmt: skip
    """Let firings end in the air before their target: `depth`, `hit` and `cosine` (columns, beams) change there.

    A firing with nothing behind ends with chance `share` * `gain` (beams,) * thickness, at `near` m and an
    exponentially distributed way of mean `scale` m, within `reach` m; a target at t m outshines the air but for
    a chance of t^2 / (t^2 + outshone^2). Thickness: `field` (n, n, n) 0..1, cells of `cell` m, repeated over the
    world and moved by `drift` (3,) m. Rays as world_rays gives them.
    """
    columns, beams = depth.shape
    state = np.empty(1, np.uint64)
    state[0] = np.uint64(seed) | np.uint64(1)
    fine, dark = 1.0 / cell, outshone * outshone
    for c in range(columns):
        ox, oy, oz = origin[c, 0] - drift[0], origin[c, 1] - drift[1], origin[c, 2] - drift[2]
        for b in range(beams):
            chance = share * gain[b]
            t = depth[c, b]
            if hit[c, b] != -1 and t < 1e8:
                chance *= t * t / (t * t + dark)
            else:
                t = np.float32(np.inf)
            u = _uniform(state)
            if u >= chance:
                continue
            r = near + scale * WAYS[np.int64(_next(state) >> np.uint64(54))]
            if r >= t or r > reach:
                continue
            x, y, z = ox + r * world[c, b, 0], oy + r * world[c, b, 1], oz - drop[b] + r * world[c, b, 2]
            if u < chance * _thickness(field, fine, x, y, z):
                depth[c, b], hit[c, b], cosine[c, b] = r, AIR, _uniform(state)


@fast_kernel
def cast_puffs(  # type: ignore[no-untyped-def]
    world, origin, level, drop, puffs, field, cell, drift, near, seed, depth, hit, cosine
):  # fmt: skip
    """Let firings end in small clouds: `puffs` (n, 5) x, y, z of the centre m, radius m, chance 0..1 of a firing
    to end in it on its way through the middle, where it is thickest. The rest as in `cast_haze`."""
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

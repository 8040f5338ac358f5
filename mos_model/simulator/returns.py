"""From hits to the points that the sensor reports: lost returns, mixed pixels, noise, remission. Kernel."""

import numpy as np

from mos_model.simulator.airborne import AIR
from runtime.classes import MOVING_LABEL
from runtime.compute.jit import fast_kernel, inlined

BODY = -8  # what `hit` says of a firing that ended on the carrier of the sensor


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
def _normal(state):  # type: ignore[no-untyped-def]
    """About a standard normal: the sum of four uniform numbers of 16 bits."""
    s = _next(state)
    m = np.uint64(0xFFFF)
    total = (s & m) + ((s >> np.uint64(16)) & m) + ((s >> np.uint64(32)) & m) + (s >> np.uint64(48))
    return np.int64(total) * (1.7320508 / 65535.0) - 3.4641016


@inlined
def _moves(label):  # type: ignore[no-untyped-def]
    return (label & np.uint32(0xFFFF)) >= np.uint32(MOVING_LABEL)


@fast_kernel
def report(  # type: ignore[no-untyped-def]
    depth, hit, cosine, prims, label, ground_label, ground_albedo, material_loss, local, world, drop, restore, hidden,
    bias, limits, noise, sensitivity, extinction, loss, stray, resolution, imperfect, seed,
):  # fmt: skip
    """Points (n, 4) float32 in the sensor frame and labels (n,) uint32, laser by laser, azimuth from 0 up.

    `label` (objects,) of the primitives' objects; `ground_label`, `ground_albedo` by surface class, then
    of what is in the air and of the carrier; `extinction` 1/m of the light;
    `material_loss` (materials,) share of returns lost; `restore` (columns, 3, 4) takes what was measured at a
    column to the scan's frame; `hidden` (columns, beams) what the vehicle itself hides; `bias` (beams,) m;
    `limits` least and greatest range; `noise` m; `loss` and `stray` shares of firings without or with a
    senseless return.
    """
    columns, beams = depth.shape
    points = np.empty((beams, columns, 4), np.float32)
    labels = np.empty((beams, columns), np.uint32)
    counts = np.zeros(beams, np.int64)
    state = np.empty(1, np.uint64)
    state[0] = np.uint64(seed) | np.uint64(1)
    steps = 1.0 / resolution
    for c in range(columns):
        r00, r01, r02, r03 = restore[c, 0, 0], restore[c, 0, 1], restore[c, 0, 2], restore[c, 0, 3]
        r10, r11, r12, r13 = restore[c, 1, 0], restore[c, 1, 1], restore[c, 1, 2], restore[c, 1, 3]
        r20, r21, r22, r23 = restore[c, 2, 0], restore[c, 2, 1], restore[c, 2, 2], restore[c, 2, 3]
        for b in range(beams):
            t, k = depth[c, b], hit[c, b]
            if hidden[c, b]:
                continue
            seen = t < 1e8 and k != -1
            if stray > 0.0 and _uniform(state) < stray:
                t = t * _uniform(state) if seen else limits[0] + 20.0 * _uniform(state) * _uniform(state)
                who, albedo, angle = np.uint32(0), 0.1, 0.5
            elif not seen:
                continue
            else:
                chance = loss
                if k >= 0:
                    who, albedo, angle = label[int(prims[k, 15])], prims[k, 22], np.float64(cosine[c, b])
                    chance += material_loss[int(prims[k, 14])]
                else:
                    who, albedo, angle = (
                        ground_label[-2 - k],
                        ground_albedo[-2 - k],
                        -np.float64(world[c, b, 2]),
                    )
                    angle = max(angle, 0.0) if k > AIR else np.float64(cosine[c, b])
                if imperfect and k != AIR:
                    power = albedo * angle / (t * t * sensitivity)
                    if extinction > 0.0:
                        power *= np.exp(-2.0 * extinction * t)
                    power *= power
                    if _uniform(state) * (1.0 + power) > power * (1.0 - chance):
                        continue
                    # The beam is wide: at an edge it may see two surfaces at once.
                    side = c + 1 if (state[0] & np.uint64(1)) == 0 else c - 1
                    side = 0 if side == columns else columns - 1 if side < 0 else side
                    other, j = depth[side, b], hit[side, b]
                    gap = other - t
                    if abs(gap) > 0.12 + 0.01 * t and other < 1e8 and j != -1 and j != AIR:
                        u = _uniform(state)
                        mix = 0.3 if abs(gap) < 2.0 else 0.05
                        if u < mix:
                            t += gap * _uniform(state)
                            second = label[int(prims[j, 15])] if j >= 0 else ground_label[-2 - j]
                            if _moves(who) != _moves(second):
                                who = np.uint32(0)
                        elif u < mix + 0.05:
                            continue
            if t < limits[0] or t > limits[1]:
                continue
            value = 1.3 * albedo * (0.55 + 0.45 * angle) * (1.15 - 0.004 * t)
            if imperfect:
                t += bias[b] + noise * (1.0 + 0.01 * t) * _normal(state)
                value += 0.05 * _normal(state)
                if value < 0.2 and (state[0] & np.uint64(3)) == 0:
                    value = 0.0
            x, y, z = local[c, b, 0] * t, local[c, b, 1] * t, local[c, b, 2] * t - drop[b]
            n = counts[b]
            counts[b] = n + 1
            points[b, n, 0] = r00 * x + r01 * y + r02 * z + r03
            points[b, n, 1] = r10 * x + r11 * y + r12 * z + r13
            points[b, n, 2] = r20 * x + r21 * y + r22 * z + r23
            points[b, n, 3] = min(max(int(value * steps + 0.5) * resolution, 0.0), 0.99)
            labels[b, n] = who
    total = counts.sum()
    flat_points, flat_labels = np.empty((total, 4), np.float32), np.empty(total, np.uint32)
    first = 0
    for b in range(beams):
        for n in range(counts[b]):
            for i in range(4):
                flat_points[first + n, i] = points[b, n, i]
            flat_labels[first + n] = labels[b, n]
        first += counts[b]
    return flat_points, flat_labels

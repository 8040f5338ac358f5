"""What stands beside a street: posts, clutter, houses, fences and hedges."""

from random import Random

import numpy as np

from mos_model.simulator.raycast import BARS, FACADE, FOLIAGE, MATT, MESH, METAL
from mos_model.simulator.shapes import Shape, box, capsule, ellipsoid, frustum


def pole(rng: Random) -> Shape:
    """A lamp post, sign, traffic light or bollard."""
    kind = rng.random()
    if kind < 0.4:
        tall = rng.uniform(4.0, 10.0)
        shape = [capsule((0, 0, -0.2), (0, 0, tall), rng.uniform(0.05, 0.14), METAL, 0.35)]
        if rng.random() < 0.5:
            shape.append(capsule((0, 0, tall - 0.1), (rng.uniform(1, 2.5), 0, tall + 0.1), 0.06, METAL, 0.3))
        return shape
    if kind < 0.75:
        tall = rng.uniform(1.8, 3.2)
        half = rng.uniform(0.15, 0.5)
        low = tall - rng.uniform(0.3, 0.9)
        return [
            capsule((0, 0, -0.2), (0, 0, tall), rng.uniform(0.025, 0.05), METAL, 0.4),
            box(0.03, 0.06, half, low, tall, METAL, 0.95),
        ]
    if kind < 0.88:
        tall = rng.uniform(2.6, 3.4)
        return [
            capsule((0, 0, -0.2), (0, 0, tall), 0.07, METAL, 0.3),
            box(0.05, 0.35, 0.16, tall - 1.0, tall, METAL, 0.1),
        ]
    return [capsule((0, 0, -0.2), (0, 0, rng.uniform(0.6, 1.1)), rng.uniform(0.04, 0.12), METAL, 0.4)]


def clutter(rng: Random) -> Shape:
    """Bins, boxes, switch cabinets, benches, stones, containers."""
    kind = rng.random()
    if kind < 0.3:
        return [frustum(0.05, rng.uniform(0.9, 1.3), -0.28, 0.28, -0.35, 0.35, 0.25, 0.32, MATT, 0.15)]
    if kind < 0.5:
        return [box(-0.25, 0.25, rng.uniform(0.3, 0.8), 0.0, rng.uniform(0.8, 1.6), MATT, 0.35)]
    if kind < 0.65:
        return [
            box(-0.25, 0.2, 0.8, 0.38, 0.46, MATT, 0.3),
            box(-0.3, -0.22, 0.8, 0.5, 0.85, BARS, 0.3, p=(0.2, 0.6, 0)),
        ]
    if kind < 0.8:
        r = rng.uniform(0.2, 0.6)
        return [ellipsoid((0, 0, 0.3 * r), (r, r * rng.uniform(0.6, 1), 0.8 * r), MATT, 0.3)]
    if kind < 0.9:
        return [frustum(0.0, 0.7, -0.15, 0.15, -0.03, 0.03, 0.15, 0.03, MATT, 0.6)]  # cone
    long, high = rng.uniform(1.0, 3.0), rng.uniform(1.2, 2.4)
    return [box(-long, long, rng.uniform(0.8, 1.2), 0.1, high, METAL, rng.uniform(0.1, 0.5))]


def building(rng: Random, wide: float, deep: float, high: float) -> Shape:
    """A house of `wide` along x and `deep` along y, windows recessed, with bays, balconies, steps, a roof."""
    half = 0.5 * wide
    glazed = rng.choice((0.0, 0.25, 0.4, 0.5, 0.7))
    front = (rng.uniform(1.6, 4.0), glazed, rng.uniform(0.06, 0.35))
    tone = rng.uniform(0.2, 0.6)
    shape = [box(-half, half, 0.5 * deep, -2.0, high, FACADE if glazed else MATT, tone, p=front)]
    rise = rng.uniform(1.0, 3.5)
    if rng.random() < 0.5:
        shape.append(frustum(high, high + rise, -half, half, -half, half, 0.5 * deep + 0.3, 0.2, MATT, 0.25))
    for _ in range(rng.choice((0, 1, 2, 4, 7))):  # what stands out of the front (y = -deep / 2)
        x, out = rng.uniform(-half, half), rng.uniform(0.15, 1.6)
        kind = rng.random()
        if kind < 0.4:
            low, top = -1.0, high * rng.uniform(0.3, 1)
        elif kind < 0.75:
            low = rng.uniform(2.4, max(high, 2.8))
            top = low + 1.1
        else:
            low, top = -0.5, rng.uniform(0.2, 0.9)
        shape.append(box(x - rng.uniform(0.4, 2), x + rng.uniform(0.4, 2), out, low, top, MATT, tone,
                         at=(0, -0.5 * deep, 0)))  # fmt: skip
    return shape


def barrier(rng: Random, long: float) -> tuple[Shape, int]:
    """A hedge, wall, fence or guard rail of length `long` along x: (shape, label)."""
    half, kind = 0.5 * long, rng.random()
    if kind < 0.35:
        thick, high = rng.uniform(0.25, 0.7), rng.uniform(0.7, 2.4)
        leaves = (rng.choice((4.0, 8.0, 14.0)), rng.choice((0.15, 0.3)), rng.uniform(0.5, 0.95))
        return [frustum(-0.1, high, -half, half, -half, half, thick, 0.8 * thick, FOLIAGE, 0.35, p=leaves)], 70
    if kind < 0.55:
        return [box(-half, half, rng.uniform(0.08, 0.2), -0.5, rng.uniform(0.4, 2.2), MATT, rng.uniform(0.2, 0.5))], 51
    if kind < 0.7:
        period = rng.uniform(0.08, 0.25)
        return [
            box(-half, half, 0.02, 0.1, rng.uniform(0.9, 1.6), BARS, 0.3, p=(period, rng.uniform(0.2, 0.8), 0)),
            box(-half, half, 0.1, -0.3, rng.uniform(0.1, 0.5), MATT, 0.3),
        ], 51
    if kind < 0.85:
        posts = [
            capsule((x, 0, -0.2), (x, 0, 1.4), 0.03, METAL, 0.3)
            for x in np.arange(-half, half, 2.5).tolist()
        ]  # fmt: skip
        return [
            box(-half, half, 0.01, 0.05, rng.uniform(1.0, 2.0), MESH, 0.3, p=(rng.uniform(0.1, 0.5), 0, 0)),
            *posts,
        ], 51
    posts = [box(x - 0.05, x + 0.05, 0.06, -0.2, 0.6, METAL, 0.3) for x in np.arange(-half, half, 4.0).tolist()]
    return [box(-half, half, 0.05, 0.45, 0.75, METAL, 0.45), *posts], 51

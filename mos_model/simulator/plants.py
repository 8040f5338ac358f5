"""Trees, bushes and woods, which some rays pass through."""

import math
from random import Random

from mos_model.simulator.raycast import FOLIAGE, MATT
from mos_model.simulator.shapes import Shape, capsule, ellipsoid, frustum


def tree(rng: Random) -> Shape:
    """A trunk and a porous crown; round, slim, spreading or bare."""
    tall = rng.uniform(3.5, 14.0)
    thick = rng.uniform(0.06, 0.13) + 0.012 * tall
    clear = rng.uniform(1.2, 3.2) if tall > 5 else rng.uniform(0.6, 1.6)
    wide = rng.uniform(0.18, 0.4) * tall
    lean = (rng.gauss(0, 0.15), rng.gauss(0, 0.15))
    shape = [capsule((0, 0, -0.3), (lean[0], lean[1], 0.75 * tall), thick, MATT, 0.25)]
    leaves = (rng.choice((0.7, 1.5, 3.0)), rng.choice((0.25, 0.4, 0.7)), rng.uniform(0.2, 0.75))
    for _ in range(rng.randint(1, 4)):
        centre = (
            rng.gauss(0, 0.3 * wide),
            rng.gauss(0, 0.3 * wide),
            clear + rng.uniform(0.35, 0.65) * (tall - clear),
        )
        radii = (
            wide * rng.uniform(0.5, 1),
            wide * rng.uniform(0.5, 1),
            0.5 * (tall - clear) * rng.uniform(0.7, 1),
        )
        shape.append(ellipsoid(centre, radii, FOLIAGE, rng.uniform(0.2, 0.5), p=leaves))
    for _ in range(rng.randint(0, 3)):
        angle, reach = rng.uniform(0, 6.28), rng.uniform(0.4, 0.9) * wide
        start = clear + 0.2 * rng.random() * tall
        end = (reach * math.cos(angle), reach * math.sin(angle), start + rng.uniform(0.3, 1.0) * reach)
        shape.append(capsule((0, 0, start), end, 0.3 * thick, MATT, 0.25))
    return shape


def conifer(rng: Random) -> Shape:
    """A conifer, dense to the ground."""
    tall = rng.uniform(2.0, 10.0)
    wide = rng.uniform(0.12, 0.3) * tall
    leaves = (rng.choice((3.0, 6.0)), 0.3, rng.uniform(0.4, 0.9))
    low = rng.uniform(0.0, 0.5)
    return [
        capsule((0, 0, -0.3), (0, 0, 0.9 * tall), 0.02 * tall, MATT, 0.25),
        frustum(low, tall, -wide, wide, -0.1, 0.1, wide, 0.1, FOLIAGE, 0.3, p=leaves),
    ]


def wood(rng: Random, wide: float) -> Shape:
    """The edge of a wood or a line of trees, `wide` along x: trunks, undergrowth and one ragged canopy."""
    tall, thick, half = rng.uniform(4, 15), rng.uniform(1.0, 4.0), 0.5 * wide
    leaves = (rng.choice((0.7, 1.5, 3.0)), rng.choice((0.4, 0.8, 1.5)), rng.uniform(0.15, 0.7))
    low = rng.uniform(0.0, 2.5)
    shape = [frustum(low, tall, -half, half, 1 - half, half - 1, thick, 0.5 * thick, FOLIAGE, 0.35, p=leaves)]
    x = -half + 1.0
    while x < half:
        y = rng.uniform(-0.5, 0.5) * thick
        shape.append(capsule((x, y, -0.5), (x + rng.gauss(0, 0.2), y, 0.7 * tall), rng.uniform(0.08, 0.3), MATT, 0.25))
        x += rng.uniform(1.5, 6.0)
    if rng.random() < 0.5:
        under = (rng.choice((2.0, 4.0)), 0.4, rng.uniform(0.3, 0.8))
        shape.append(
            frustum(
                -0.3,
                rng.uniform(0.5, 2.5),
                -half,
                half,
                -half,
                half,
                thick,
                0.7 * thick,
                FOLIAGE,
                0.35,
                p=under,
            )
        )
    return shape


def bush(rng: Random) -> Shape:
    """One or several round shrubs."""
    leaves = (rng.choice((2.0, 4.0, 8.0)), rng.choice((0.15, 0.3)), rng.uniform(0.3, 0.9))
    shape = []
    for _ in range(rng.randint(1, 3)):
        r = rng.uniform(0.3, 1.3)
        centre = (rng.gauss(0, 0.6), rng.gauss(0, 0.6), rng.uniform(0.3, 0.8) * r)
        shape.append(
            ellipsoid(centre, (r, r * rng.uniform(0.6, 1), r * rng.uniform(0.6, 1.1)), FOLIAGE, 0.35, p=leaves)
        )
    return shape

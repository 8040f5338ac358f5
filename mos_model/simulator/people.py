"""People on foot."""

from random import Random

from mos_model.simulator.raycast import CLOTH, MESH
from mos_model.simulator.shapes import Shape, box, capsule, ellipsoid, frustum


def person(rng: Random, walks: bool) -> tuple[Shape, float, float]:
    """A person, standing or with limbs that swing; some with a bag, a pram, a child's size, an open coat."""
    tall = rng.uniform(1.5, 1.95) if rng.random() < 0.87 else rng.uniform(0.95, 1.4)
    k = tall / 1.75
    hip, shoulder = 0.5 * tall, 0.81 * tall
    dark, stride, phase = rng.choice((0.04, 0.1, 0.2, 0.35, 0.5)), 1.45 * k, rng.uniform(0, 6.28)
    amp = rng.uniform(0.4, 0.6) if walks else 0.0
    stand = 0.0 if walks else rng.uniform(-0.12, 0.12)
    wide = rng.uniform(0.9, 1.25)
    shape = [
        ellipsoid((0, 0, 0.93 * tall), (0.1 * k, 0.08 * k, 0.125 * k), CLOTH, 0.4),
        ellipsoid((0, 0, 0.67 * tall), (0.13 * k * wide, 0.22 * k * wide, 0.19 * tall), CLOTH, dark),
    ]
    for side in (-1, 1):
        y = 0.1 * side * k
        shape.append(
            capsule((0, y, hip), (side * stand, y, 0.06), 0.08 * k * wide, CLOTH, rng.choice((dark, 0.1)),
                    swing=(side * amp, stride, phase))
        )  # fmt: skip
        y = 0.24 * side * k * wide
        reach = 0.0 if walks else rng.choice((0.0, 0.0, 0.15, 0.3))
        shape.append(
            capsule((0, y, shoulder - 0.04), (reach, y, 0.46 * tall + 0.4 * reach), 0.05 * k, CLOTH, dark,
                    swing=(-0.8 * side * amp, stride, phase))
        )  # fmt: skip
    extra = rng.random()
    if extra < 0.12:  # long coat or skirt
        shape.append(frustum(0.25 * tall, 0.6 * tall, -0.2, 0.2, -0.13, 0.13, 0.24 * k, 0.18 * k, CLOTH, dark))
    elif extra < 0.22:  # rucksack
        shape.append(ellipsoid((-0.22, 0, 0.7 * tall), (0.14, 0.16, 0.25), CLOTH, 0.2))
    elif extra < 0.29:  # bag
        shape.append(box(-0.2, 0.2, 0.08, 0.25, 0.6, CLOTH, 0.2, at=(0, 0.35, 0)))
    elif extra < 0.34:  # pram or trolley
        shape.append(box(0.35, 1.05, 0.26, 0.35, 0.95, CLOTH, 0.15))
        shape.append(box(0.4, 1.0, 0.24, 0.0, 0.3, MESH, 0.1, p=(0.4, 0, 0)))
    elif extra < 0.38:  # dog
        shape.append(ellipsoid((0.3, 0.6, 0.35), (0.35, 0.12, 0.15), CLOTH, 0.2))
        shape.append(box(0.05, 0.55, 0.08, 0.0, 0.3, MESH, 0.2, at=(0, 0.6, 0), p=(0.5, 0, 0)))
    return shape, 0.5, 0.6

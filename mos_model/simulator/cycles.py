"""Scooters, motorcycles and their riders of many kinds, and scooters to stand on."""

from random import Random

from mos_model.simulator import vehicles
from mos_model.simulator.pedestrians import ALBEDOS, pedestrian
from mos_model.simulator.raycast import CLOTH, MATT, METAL, PAINT
from mos_model.simulator.shapes import Shape, box, capsule, ellipsoid, frustum


def powered(rng: Random) -> tuple[Shape, float, float]:
    """A ridden scooter or motorcycle; some with a box, a windshield, bags, a second rider."""
    if rng.random() < 0.35:
        shape, length, width = vehicles.motorcycle(rng, True)
    else:
        shape, length, width = _scooter(rng), 1.8, 0.75
        shape += vehicles.rider(rng, 0.78, rng.uniform(0.0, 0.25), False)
    extra = rng.random()
    if extra < 0.18:
        half = rng.uniform(0.16, 0.28)
        shape.append(box(-0.95, -0.55, half, 0.85, 0.85 + 1.6 * half, MATT, rng.choice(ALBEDOS)))
    elif extra < 0.36:
        behind = vehicles.rider(rng, 0.84, rng.uniform(0.0, 0.2), False)
        for row in behind:
            row[1] -= 0.42
        shape += behind
    elif extra < 0.46:
        shape.append(box(-0.6, -0.2, 0.4, 0.35, 0.75, CLOTH, rng.choice(ALBEDOS)))
    return shape, length, width


def _scooter(rng: Random) -> Shape:
    paint = rng.choice((0.03, 0.1, 0.25, 0.5, 0.7))
    return [
        *(ellipsoid((x, 0, 0.24), (0.24, 0.06, 0.24), MATT, 0.06) for x in (-0.6, 0.62)),
        box(-0.8, -0.1, 0.17, 0.32, 0.78, PAINT, paint),
        box(-0.15, 0.4, 0.2, 0.22, 0.32, PAINT, paint),
        frustum(0.3, 1.0, 0.36, 0.46, 0.26, 0.36, 0.22, 0.18, PAINT, paint),
        capsule((0.32, -0.33, 1.02), (0.32, 0.33, 1.02), 0.03, METAL, 0.2),
    ]


def kick_scooter(rng: Random) -> tuple[Shape, float, float]:
    """Somebody who stands on an electric scooter."""
    shape = list(pedestrian(rng, runs=True, child=False).shape)  # elbows bent, nothing in hands
    for row in shape:
        row[3] += 0.14
        row[17] = row[19] = 0.0
    shape += [
        box(-0.45, 0.4, 0.08, 0.08, 0.16, METAL, 0.2),
        capsule((0.45, 0, 0.1), (0.35, 0, 1.1), 0.025, METAL, 0.2),
        capsule((0.35, -0.22, 1.1), (0.35, 0.22, 1.1), 0.02, METAL, 0.2),
    ]
    return shape, 1.1, 0.6

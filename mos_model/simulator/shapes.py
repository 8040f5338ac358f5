"""Vehicles, people and street furniture as lists of primitives (rows of `raycast`), each in its own frame: x forward,
y left, z up from the ground, m."""

import math
from random import Random

import numpy as np

from mos_model.simulator.raycast import (
    BARS,
    CABIN,
    CAPSULE,
    CLOTH,
    COLUMNS,
    ELLIPSOID,
    FACADE,
    FOLIAGE,
    FRUSTUM,
    MATT,
    MESH,
    METAL,
    PAINT,
)

Row = list[float]
Shape = list[Row]


def _row(kind, at, yaw, geometry, material, albedo, parameters=(0.0, 0.0, 0.0), swing=(0.0, 1.0, 0.0)) -> Row:
    geometry = (*geometry, *(0.0,) * (8 - len(geometry)))
    return [kind, *at, math.cos(yaw), math.sin(yaw), *geometry, material, 0.0, *parameters, *swing, albedo]


def frustum(
    z0,
    z1,
    rear0,
    front0,
    rear1,
    front1,
    half0,
    half1,
    material=MATT,
    albedo=0.3,
    at=(0, 0, 0),
    yaw=0.0,
    p=(0, 0, 0),
) -> Row:
    """A box whose four sides may lean."""
    return _row(FRUSTUM, at, yaw, (z0, z1, rear0, front0, rear1, front1, half0, half1), material, albedo, p)


def box(x0, x1, half, z0, z1, material=MATT, albedo=0.3, at=(0, 0, 0), yaw=0.0, p=(0, 0, 0)) -> Row:
    """A box from x0 to x1, `half` to both sides, z0 to z1."""
    return frustum(z0, z1, x0, x1, x0, x1, half, half, material, albedo, at, yaw, p)


def ellipsoid(centre, radii, material=CLOTH, albedo=0.3, at=(0, 0, 0), yaw=0.0, p=(0, 0, 0)) -> Row:
    """An ellipsoid."""
    return _row(ELLIPSOID, at, yaw, (*centre, *radii), material, albedo, p)


def capsule(
    a, b, radius, material=METAL, albedo=0.3, at=(0, 0, 0), yaw=0.0, p=(0, 0, 0), swing=(0, 1, 0)
) -> Row:
    """A rod with round ends from a to b; `swing` (rad, stride m, phase) moves b about a as the object advances."""
    return _row(CAPSULE, at, yaw, (*a, *b, radius), material, albedo, p, swing)


def array(shape: Shape) -> np.ndarray:
    """The shape as (n, COLUMNS) float64."""
    return np.array(shape, np.float64).reshape(-1, COLUMNS)


def _glass(rng: Random) -> float:
    return rng.choice((0.1, 0.25, 0.5, 0.85))


def _paint(rng: Random) -> float:
    return rng.choice((0.02, 0.04, 0.08, 0.2, 0.3, 0.45, 0.6))


def _gloss(rng: Random, shape: Shape) -> Shape:
    """Give all painted parts of a vehicle one gloss."""
    gloss = rng.choice((0.0, 0.0, 0.05, 0.15, 0.4, 0.8))
    for row in shape:
        if row[14] == PAINT:
            row[16] = gloss
    return shape


def _axles(length, width, clearance, colour) -> Shape:
    wheel = 0.31
    spread = 0.3 * length
    return [
        box(x - wheel, x + wheel, 0.5 * width - 0.03, 0.0, clearance + 0.25, MATT, 0.06)
        for x in (-spread, spread)
    ]


def car(rng: Random) -> tuple[Shape, float, float]:
    """A passenger car of some body style: (shape, length, width)."""
    style = rng.choice(("saloon", "estate", "hatch", "hatch", "suv", "mpv"))
    length = {"saloon": 4.6, "estate": 4.6, "hatch": 3.9, "suv": 4.5, "mpv": 4.3}[style] + rng.uniform(
        -0.3, 0.3
    )
    width = rng.uniform(1.62, 1.88)
    high = {"saloon": 1.43, "estate": 1.46, "hatch": 1.47, "suv": 1.7, "mpv": 1.65}[style] + rng.uniform(
        -0.05, 0.08
    )
    belt = 0.58 * high + rng.uniform(0.0, 0.08)
    clearance = rng.uniform(0.18, 0.3)
    tail, nose = -0.5 * length, 0.5 * length
    colour, glass = _paint(rng), (belt + 0.05, high - 0.1, _glass(rng))
    hood = rng.uniform(0.9, 1.25) * (0.8 if style == "mpv" else 1.0)
    boot = {"saloon": 0.75, "estate": 0.05, "hatch": 0.1, "suv": 0.08, "mpv": 0.05}[style]
    slant = {"saloon": 0.65, "estate": 0.3, "hatch": 0.35, "suv": 0.25, "mpv": 0.2}[style]
    rake = rng.uniform(0.55, 0.85)
    half = 0.5 * width
    shape = [
        frustum(clearance, belt * 0.8, tail + 0.1, nose - 0.08, tail, nose, half - 0.04, half, PAINT, colour),
        frustum(belt * 0.8, belt, tail, nose, tail + 0.06, nose - 0.35, half, half - 0.06, PAINT, colour),
        frustum(
            belt, high, tail + boot, nose - hood, tail + boot + slant, nose - hood - rake, half - 0.08, half - 0.26,
            CABIN, colour, p=glass,
        ),
        *_axles(length, width, clearance, colour),
    ]  # fmt: skip
    if rng.random() < 0.1:
        shape.append(
            box(tail + boot + slant + 0.1, nose - hood - rake - 0.1, 0.35, high, high + 0.3, PAINT, 0.1)
        )
    return _gloss(rng, shape), length, width


def van(rng: Random) -> tuple[Shape, float, float]:
    """A delivery van."""
    length, width, high = rng.uniform(4.6, 6.4), rng.uniform(1.85, 2.1), rng.uniform(1.85, 2.7)
    half, colour, tail, nose = 0.5 * width, _paint(rng), -0.5 * length, 0.5 * length
    shape = [
        frustum(0.3, 1.0, tail, nose, tail, nose - 0.1, half, half, PAINT, colour),
        frustum(
            1.0, high, tail, nose - 0.6, tail + 0.05, nose - 1.5, half, half - 0.12,
            CABIN if rng.random() < 0.4 else PAINT, colour, p=(1.15, 1.75, 0.4),
        ),
        *_axles(length, width, 0.3, colour),
    ]  # fmt: skip
    return _gloss(rng, shape), length, width


def truck(rng: Random) -> tuple[Shape, float, float]:
    """A lorry with a box, a flat bed or a tank, sometimes with a trailer."""
    length, width, high = rng.uniform(6.0, 11.0), rng.uniform(2.2, 2.5), rng.uniform(2.9, 3.9)
    if rng.random() < 0.3:
        length = rng.uniform(13.0, 16.5)
    half, colour, tail, nose = 0.5 * width, _paint(rng), -0.5 * length, 0.5 * length
    cab = rng.uniform(1.8, 2.3)
    shape = [
        box(nose - cab, nose, half - 0.05, 0.5, 1.4, PAINT, colour),
        frustum(1.4, min(high, 2.9), nose - cab, nose, nose - cab, nose - 0.2, half - 0.05, half - 0.1, CABIN, colour,
                p=(1.6, 2.3, 0.4)),
        box(tail + 0.3, nose - cab, 0.45, 0.5, 1.0, METAL, 0.1),
    ]  # fmt: skip
    body = rng.random()
    if body < 0.6:
        shape.append(box(tail, nose - cab - 0.3, half, 1.0, high, MATT, rng.uniform(0.1, 0.6)))
    elif body < 0.8:
        shape.append(
            box(tail, nose - cab - 0.3, half, 1.0, 1.0 + rng.uniform(0.15, 1.0), MATT, rng.uniform(0.1, 0.4))
        )
    else:
        middle = 0.5 * (tail + nose - cab - 0.3)
        shape.append(ellipsoid((middle, 0, 1.9), (0.5 * (nose - cab - tail), half, 1.0), METAL, 0.4))
    for x in (tail + 1.0, tail + 2.2, nose - 1.2):
        shape.append(box(x - 0.48, x + 0.48, half, 0.0, 1.0, MATT, 0.05))
    return _gloss(rng, shape), length, width


def bus(rng: Random) -> tuple[Shape, float, float]:
    """A city bus or coach."""
    length, width, high = rng.uniform(9.0, 13.0), 2.5, rng.uniform(2.9, 3.4)
    half, colour, tail, nose = 1.25, _paint(rng), -0.5 * length, 0.5 * length
    shape = [
        box(tail, nose, half, 0.3, 1.2, PAINT, colour),
        box(tail, nose, half - 0.02, 1.2, high, CABIN, colour, p=(1.3, 2.4, rng.choice((0.3, 0.6, 0.9)))),
    ]
    for x in (tail + 2.6, nose - 2.4):
        shape.append(box(x - 0.5, x + 0.5, half - 0.02, 0.0, 0.5, MATT, 0.05))
    return _gloss(rng, shape), length, width


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
        shape.append(
            frustum(0.25 * tall, 0.6 * tall, -0.2, 0.2, -0.13, 0.13, 0.24 * k, 0.18 * k, CLOTH, dark)
        )
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


def bicycle(rng: Random) -> tuple[Shape, float, float]:
    """A bicycle without rider."""
    shape = [ellipsoid((x, 0, 0.34), (0.34, 0.025, 0.34), MESH, 0.15, p=(0.3, 0, 0)) for x in (-0.52, 0.52)]
    shape += [
        capsule((-0.5, 0, 0.34), (-0.1, 0, 0.85), 0.025, METAL, 0.2),
        capsule((-0.15, 0, 0.75), (0.42, 0, 0.8), 0.025, METAL, 0.2),
        capsule((0.52, 0, 0.34), (0.4, 0, 1.0), 0.025, METAL, 0.2),
        capsule((0.4, -0.28, 1.02), (0.4, 0.28, 1.02), 0.025, METAL, 0.2),
    ]
    return shape, 1.75, 0.55


def _rider(rng: Random, seat: float, lean: float, pedals: bool) -> Shape:
    dark, k = rng.choice((0.05, 0.15, 0.3, 0.5)), rng.uniform(0.9, 1.08)
    top = (0.55 * k * math.sin(lean) - 0.15, 0.0, seat + 0.55 * k * math.cos(lean))
    shape = [
        capsule((-0.18, 0, seat + 0.12), top, 0.16 * k, CLOTH, dark),
        ellipsoid((top[0] + 0.08, 0, top[2] + 0.3), (0.12, 0.1, 0.14), CLOTH, 0.4),
    ]
    for side in (-1, 1):
        shape.append(
            capsule((top[0], 0.2 * side, top[2]), (0.42, 0.24 * side, seat + 0.15), 0.05, CLOTH, dark)
        )
        swing = (0.35 * side, 4.5, 0.0) if pedals else (0, 1, 0)
        shape.append(
            capsule(
                (-0.12, 0.1 * side, seat), (0.1, 0.12 * side, seat - 0.68), 0.075, CLOTH, dark, swing=swing
            )
        )
    return shape


def cyclist(rng: Random) -> tuple[Shape, float, float]:
    """A bicycle with its rider."""
    return bicycle(rng)[0] + _rider(rng, 0.92, rng.uniform(0.15, 0.8), True), 1.75, 0.6


def motorcycle(rng: Random, ridden: bool) -> tuple[Shape, float, float]:
    """A motorcycle or scooter, with or without rider."""
    shape = [ellipsoid((x, 0, 0.3), (0.3, 0.07, 0.3), MATT, 0.06) for x in (-0.65, 0.65)]
    shape += [
        ellipsoid((0, 0, 0.6), (0.75, 0.2, 0.3), PAINT, _paint(rng)),
        capsule((0.65, 0, 0.3), (0.45, 0, 1.05), 0.06, METAL, 0.2),
        capsule((0.42, -0.33, 1.05), (0.42, 0.33, 1.05), 0.03, METAL, 0.2),
    ]
    return shape + (_rider(rng, 0.82, rng.uniform(0.05, 0.5), False) if ridden else []), 2.0, 0.75


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
        shape.append(
            capsule((x, y, -0.5), (x + rng.gauss(0, 0.2), y, 0.7 * tall), rng.uniform(0.08, 0.3), MATT, 0.25)
        )
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
            ellipsoid(
                centre, (r, r * rng.uniform(0.6, 1), r * rng.uniform(0.6, 1.1)), FOLIAGE, 0.35, p=leaves
            )
        )
    return shape


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
    """A house of `wide` along x and `deep` along y, windows recessed, with some bays, balconies, steps, a roof."""
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
        return [
            frustum(-0.1, high, -half, half, -half, half, thick, 0.8 * thick, FOLIAGE, 0.35, p=leaves)
        ], 70
    if kind < 0.55:
        return [
            box(-half, half, rng.uniform(0.08, 0.2), -0.5, rng.uniform(0.4, 2.2), MATT, rng.uniform(0.2, 0.5))
        ], 51
    if kind < 0.7:
        period = rng.uniform(0.08, 0.25)
        return [
            box(
                -half, half, 0.02, 0.1, rng.uniform(0.9, 1.6), BARS, 0.3, p=(period, rng.uniform(0.2, 0.8), 0)
            ),
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
    posts = [
        box(x - 0.05, x + 0.05, 0.06, -0.2, 0.6, METAL, 0.3) for x in np.arange(-half, half, 4.0).tolist()
    ]
    return [box(-half, half, 0.05, 0.45, 0.75, METAL, 0.45), *posts], 51

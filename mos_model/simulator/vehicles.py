"""Vehicles, with and without riders; each draw gives its shape, length and width in m."""

import math
from random import Random

from mos_model.simulator.raycast import CABIN, CLOTH, MATT, MESH, METAL, PAINT
from mos_model.simulator.shapes import Shape, box, capsule, ellipsoid, frustum


def _paint(rng: Random) -> float:
    return rng.choice((0.02, 0.04, 0.08, 0.2, 0.3, 0.45, 0.6))


def _glass(rng: Random) -> float:
    return rng.choice((0.1, 0.25, 0.5, 0.85))


def _gloss(rng: Random, shape: Shape) -> Shape:
    """Give all painted parts of a vehicle one gloss."""
    gloss = rng.choice((0.0, 0.0, 0.05, 0.15, 0.4, 0.8))
    for row in shape:
        if row[14] == PAINT:
            row[16] = gloss
    return shape


def _axles(length: float, width: float, clearance: float) -> Shape:
    wheel = 0.31
    spread = 0.3 * length
    return [box(x - wheel, x + wheel, 0.5 * width - 0.03, 0.0, clearance + 0.25, MATT, 0.06) for x in (-spread, spread)]


def car(rng: Random) -> tuple[Shape, float, float]:
    """A passenger car of some body style: (shape, length, width)."""
    style = rng.choice(("saloon", "estate", "hatch", "hatch", "suv", "mpv"))
    length = {"saloon": 4.6, "estate": 4.6, "hatch": 3.9, "suv": 4.5, "mpv": 4.3}[style] + rng.uniform(-0.3, 0.3)
    width = rng.uniform(1.62, 1.88)
    high = {"saloon": 1.43, "estate": 1.46, "hatch": 1.47, "suv": 1.7, "mpv": 1.65}[style] + rng.uniform(-0.05, 0.08)
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
            belt, high, tail + boot, nose - hood, tail + boot + slant, nose - hood - rake,
            half - 0.08, half - 0.26, CABIN, colour, p=glass,
        ),
        *_axles(length, width, clearance),
    ]  # fmt: skip
    if rng.random() < 0.1:
        shape.append(box(tail + boot + slant + 0.1, nose - hood - rake - 0.1, 0.35, high, high + 0.3, PAINT, 0.1))
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
        *_axles(length, width, 0.3),
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
        frustum(1.4, min(high, 2.9), nose - cab, nose, nose - cab, nose - 0.2, half - 0.05, half - 0.1, CABIN,
                colour, p=(1.6, 2.3, 0.4)),
        box(tail + 0.3, nose - cab, 0.45, 0.5, 1.0, METAL, 0.1),
    ]  # fmt: skip
    body = rng.random()
    if body < 0.6:
        shape.append(box(tail, nose - cab - 0.3, half, 1.0, high, MATT, rng.uniform(0.1, 0.6)))
    elif body < 0.8:
        shape.append(box(tail, nose - cab - 0.3, half, 1.0, 1.0 + rng.uniform(0.15, 1.0), MATT, rng.uniform(0.1, 0.4)))
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


def cyclist(rng: Random) -> tuple[Shape, float, float]:
    """A bicycle with its rider."""
    return bicycle(rng)[0] + rider(rng, 0.92, rng.uniform(0.15, 0.8), True), 1.75, 0.6


def motorcycle(rng: Random, ridden: bool) -> tuple[Shape, float, float]:
    """A motorcycle or scooter, with or without rider."""
    shape = [ellipsoid((x, 0, 0.3), (0.3, 0.07, 0.3), MATT, 0.06) for x in (-0.65, 0.65)]
    shape += [
        ellipsoid((0, 0, 0.6), (0.75, 0.2, 0.3), PAINT, _paint(rng)),
        capsule((0.65, 0, 0.3), (0.45, 0, 1.05), 0.06, METAL, 0.2),
        capsule((0.42, -0.33, 1.05), (0.42, 0.33, 1.05), 0.03, METAL, 0.2),
    ]
    return shape + (rider(rng, 0.82, rng.uniform(0.05, 0.5), False) if ridden else []), 2.0, 0.75


def rider(rng: Random, seat: float, lean: float, pedals: bool) -> Shape:
    """Somebody on a saddle of height `seat` m, leaning forward by `lean` radians."""
    dark, k = rng.choice((0.05, 0.15, 0.3, 0.5)), rng.uniform(0.9, 1.08)
    top = (0.55 * k * math.sin(lean) - 0.15, 0.0, seat + 0.55 * k * math.cos(lean))
    shape = [
        capsule((-0.18, 0, seat + 0.12), top, 0.16 * k, CLOTH, dark),
        ellipsoid((top[0] + 0.08, 0, top[2] + 0.3), (0.12, 0.1, 0.14), CLOTH, 0.4),
    ]
    for side in (-1, 1):
        shape.append(capsule((top[0], 0.2 * side, top[2]), (0.42, 0.24 * side, seat + 0.15), 0.05, CLOTH, dark))
        swing = (0.35 * side, 4.5, 0.0) if pedals else (0, 1, 0)
        shape.append(
            capsule((-0.12, 0.1 * side, seat), (0.1, 0.12 * side, seat - 0.68), 0.075, CLOTH, dark, swing=swing)
        )
    return shape

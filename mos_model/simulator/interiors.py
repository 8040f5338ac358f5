"""What stands in rooms. Each draw gives a shape that looks along x, its foot (rear, front, half width, m) and label."""

from random import Random

from mos_model.simulator import vehicles
from mos_model.simulator.raycast import BARS, CLOTH, FOLIAGE, MATT, MESH, METAL, PAINT
from mos_model.simulator.shapes import Shape, box, capsule, ellipsoid, frustum

Foot = tuple[float, float, float]
Piece = tuple[Shape, Foot, int]
THING, WALL, PLANT, COLUMN = 99, 50, 70, 80  # labels


def _tone(rng: Random) -> float:
    return rng.choice((0.04, 0.08, 0.15, 0.3, 0.45, 0.6, 0.8)) * rng.uniform(0.85, 1.2)


def _boxed(shape: Shape, long: float, wide: float, label: int = THING) -> Piece:
    return shape, (-0.5 * long, 0.5 * long, 0.5 * wide), label


def table(rng: Random) -> Piece:
    """A table or desk on four legs or two panels, perhaps with a screen and things on it."""
    long, wide, high, tone = rng.uniform(0.5, 0.95), rng.uniform(0.7, 2.2), rng.uniform(0.45, 0.78), _tone(rng)
    x, y = 0.5 * long, 0.5 * wide
    shape = [box(-x, x, y, high - 0.04, high, MATT, tone)]
    if rng.random() < 0.7:
        legs = [(a * (x - 0.05), b * (y - 0.05)) for a in (-1, 1) for b in (-1, 1)]
        shape += [capsule((a, b, 0.0), (a, b, high - 0.05), 0.025, METAL, 0.3) for a, b in legs]
    else:
        shape += [
            box(-x + 0.03, x - 0.03, 0.015, 0.0, high - 0.04, MATT, tone, at=(0, b * (y - 0.03), 0)) for b in (-1, 1)
        ]
    for _ in range(rng.choice((0, 0, 1, 2, 4)) if high > 0.6 else 0):
        u, v, tall = rng.uniform(-0.6, 0.6) * x, rng.uniform(-0.8, 0.8) * y, rng.uniform(0.03, 0.45)
        thick, half = rng.uniform(0.02, 0.15), rng.uniform(0.04, 0.28)
        shape.append(
            box(u - thick, u + thick, half, high, high + tall, rng.choice((MATT, PAINT)), _tone(rng), at=(0, v, 0))
        )
    return _boxed(shape, long, wide)


def chair(rng: Random) -> Piece:
    """A chair with four legs, or one that turns on a foot; its back is behind."""
    seat, tone = rng.uniform(0.42, 0.5), _tone(rng)
    shape = [
        box(-0.22, 0.22, 0.22, seat - 0.05, seat, CLOTH, tone),
        box(-0.25, -0.2, 0.2, seat + 0.08, seat + rng.uniform(0.3, 0.6), CLOTH, tone),
    ]
    if rng.random() < 0.5:
        shape += [capsule((a, b, 0.0), (a, b, seat), 0.015, METAL, 0.3) for a in (-0.2, 0.2) for b in (-0.19, 0.19)]
    else:
        shape += [
            capsule((0, 0, 0.1), (0, 0, seat), 0.03, METAL, 0.3),
            capsule((-0.28, 0, 0.06), (0.28, 0, 0.06), 0.03, MATT, 0.1),
            capsule((0, -0.28, 0.06), (0, 0.28, 0.06), 0.03, MATT, 0.1),
        ]
    return _boxed(shape, 0.55, 0.5)


def cupboard(rng: Random) -> Piece:
    """A closed cabinet, cupboard, fridge or chest of drawers."""
    long, wide, high = (
        rng.uniform(0.3, 0.65),
        rng.uniform(0.4, 2.4),
        rng.choice((rng.uniform(0.5, 1.2), rng.uniform(1.6, 2.2))),
    )
    material = rng.choice((MATT, MATT, PAINT, METAL))
    return _boxed([box(-0.5 * long, 0.5 * long, 0.5 * wide, 0.0, high, material, _tone(rng))], long, wide)


def shelf(rng: Random) -> Piece:
    """Open shelves with boxes and books."""
    long, wide, high, tone = rng.uniform(0.25, 0.5), rng.uniform(0.6, 2.2), rng.uniform(1.0, 2.2), _tone(rng)
    x, y, boards = 0.5 * long, 0.5 * wide, rng.randint(3, 5)
    shape = [box(-x, x, 0.012, 0.0, high, MATT, tone, at=(0, b * y, 0)) for b in (-1, 1)]
    if rng.random() < 0.5:
        shape.append(box(-x, -x + 0.01, y, 0.0, high, MATT, tone))
    for k in range(boards):
        z = 0.05 + (high - 0.07) * k / (boards - 1)
        shape.append(box(-x, x, y, z, z + 0.02, MATT, tone))
        if k < boards - 1 and rng.random() < 0.8:
            room, half = (high - 0.1) / (boards - 1), rng.uniform(0.2, 0.95) * y
            v = rng.uniform(-1, 1) * (y - half)
            top = z + 0.02 + rng.uniform(0.3, 0.9) * room
            shape.append(
                box(-x + 0.02, rng.uniform(-0.3, 0.9) * x, half, z + 0.02, top, MATT, _tone(rng), at=(0, v, 0))
            )
    return _boxed(shape, long, wide)


def sofa(rng: Random) -> Piece:
    """A sofa, armchair or bed."""
    wide, tone = rng.uniform(0.8, 2.4), _tone(rng)
    if rng.random() < 0.25:
        return _boxed(
            [box(-1.0, 1.0, 0.45 * wide, 0.1, 0.5, CLOTH, tone), box(-1.05, -1.0, 0.45 * wide, 0.0, 0.9)], 2.1, wide
        )
    shape = [
        box(-0.4, 0.4, 0.5 * wide, 0.1, 0.43, CLOTH, tone),
        frustum(0.43, 0.85, -0.4, -0.15, -0.4, -0.3, 0.5 * wide, 0.5 * wide, CLOTH, tone),
    ]
    shape += [box(-0.4, 0.4, 0.1, 0.1, 0.62, CLOTH, tone, at=(0, b * (0.5 * wide - 0.1), 0)) for b in (-1, 1)]
    return _boxed(shape, 0.85, wide)


def boxes(rng: Random) -> Piece:
    """A box, a bin or a stack of cartons."""
    x, y, shape, z = rng.uniform(0.12, 0.5), rng.uniform(0.12, 0.5), [], 0.0
    for _ in range(rng.choice((1, 1, 2, 3, 4))):
        high, turn, grow = rng.uniform(0.2, 0.6), rng.gauss(0, 0.1), rng.uniform(0.7, 1.0)
        shape.append(box(-grow * x, grow * x, grow * y, z, z + high, MATT, _tone(rng), yaw=turn))
        z += high
    return _boxed(shape, 2.2 * x, 2.2 * y)


def plant(rng: Random) -> Piece:
    """A plant in a pot."""
    tall, pot = rng.uniform(0.6, 2.2), rng.uniform(0.12, 0.25)
    leaves = (rng.choice((4.0, 8.0)), rng.choice((0.08, 0.15)), rng.uniform(0.3, 0.8))
    return _boxed(
        [
            frustum(0.0, 0.35, -0.8 * pot, 0.8 * pot, -pot, pot, 0.8 * pot, pot, MATT, _tone(rng)),
            ellipsoid((0, 0, 0.5 * (tall + 0.4)), (1.6 * pot, 1.6 * pot, 0.5 * (tall - 0.35)), FOLIAGE, 0.4, p=leaves),
        ],
        2 * pot, 2 * pot, PLANT,
    )  # fmt: skip


def machine(rng: Random) -> Piece:
    """A machine, bench or oven: blocks, pipes and a guard."""
    long, wide = rng.uniform(0.6, 2.5), rng.uniform(0.6, 3.5)
    shape = [box(-0.5 * long, 0.5 * long, 0.5 * wide, 0.0, rng.uniform(0.5, 1.3), METAL, _tone(rng))]
    for _ in range(rng.randint(1, 4)):
        x, y, high = rng.uniform(-0.3, 0.3) * long, rng.uniform(-0.3, 0.3) * wide, rng.uniform(1.0, 2.6)
        if rng.random() < 0.6:
            shape.append(
                box(
                    x - 0.2 * long,
                    x + 0.2 * long,
                    0.2 * wide,
                    0.4,
                    high,
                    rng.choice((PAINT, METAL)),
                    _tone(rng),
                    at=(0, y, 0),
                )
            )
        else:
            shape.append(
                capsule((x, y, 0.4), (x + rng.uniform(-0.3, 0.3), y, high), rng.uniform(0.03, 0.15), METAL, _tone(rng))
            )
    if rng.random() < 0.3:
        shape.append(box(0.5 * long, 0.5 * long + 0.02, 0.5 * wide, 0.1, 2.0, MESH, 0.3, p=(0.3, 0, 0)))
    return _boxed(shape, long, wide)


def rack(rng: Random) -> Piece:
    """A rack for pallets, as stores have them, along y."""
    wide, levels, tone = rng.uniform(2.5, 12.0), rng.randint(2, 4), _tone(rng)
    y, high = 0.5 * wide, 1.6 * levels
    shape = [box(-0.5, 0.5, 0.04, 0.0, high, BARS, 0.3, at=(0, b * y, 0), p=(0.9, 0.15, 0)) for b in (-1, 1)]
    for level in range(levels):
        z = 1.6 * level + 0.1
        shape.append(box(-0.5, 0.5, y, z, z + 0.1, MESH, tone, p=(0.5, 0, 0)))
        v = -y
        while v < y - 0.9 and len(shape) < 30:
            if rng.random() < 0.7:
                half = rng.uniform(0.3, 0.5)
                shape.append(
                    box(
                        -0.45,
                        rng.uniform(0.2, 0.5),
                        half,
                        z + 0.1,
                        z + rng.uniform(0.4, 1.4),
                        MATT,
                        _tone(rng),
                        at=(0, v + 0.6, 0),
                    )
                )
            v += rng.choice((1.1, 1.1, 2.4))
    return _boxed(shape, 1.1, wide)


def column(rng: Random) -> Piece:
    """A column, square or round, higher than any ceiling."""
    half = rng.uniform(0.1, 0.45)
    if rng.random() < 0.6:
        return _boxed([box(-half, half, half, 0.0, 12.0, MATT, rng.uniform(0.3, 0.8))], 2 * half, 2 * half, WALL)
    return _boxed([capsule((0, 0, 0), (0, 0, 12.0), half, MATT, rng.uniform(0.3, 0.8))], 2 * half, 2 * half, COLUMN)


def partition(rng: Random) -> Piece:
    """A screen or a short wall, along y."""
    wide, thick = rng.uniform(0.8, 3.0), rng.uniform(0.02, 0.08)
    high = rng.choice((rng.uniform(1.1, 1.9), 12.0))
    return _boxed([box(-thick, thick, 0.5 * wide, 0.0, high, MATT, rng.uniform(0.2, 0.8))], 2 * thick, wide, WALL)


def lamp(rng: Random) -> Piece:
    """A lamp, coat stand, tripod or sign on a pole."""
    high = rng.uniform(1.1, 1.9)
    shape = [
        capsule((0, 0, 0), (0, 0, high), 0.02, METAL, 0.3),
        capsule((-0.18, 0, 0.03), (0.18, 0, 0.03), 0.03, METAL, 0.3),
        ellipsoid((0, 0, high), (rng.uniform(0.05, 0.25), 0.2, rng.uniform(0.05, 0.2)), CLOTH, 0.6),
    ]
    return _boxed(shape, 0.4, 0.4)


def parked(rng: Random) -> Piece:
    """A car, as garages have them."""
    shape, length, width = vehicles.car(rng)
    return shape, (-0.5 * length, 0.5 * length, 0.5 * width), 10


def fixture(rng: Random, high: float) -> Piece:
    """What hangs on a wall: a radiator, board, picture, cable duct or curtain, under a ceiling of `high` m."""
    wide, kind = rng.uniform(0.4, 2.5), rng.random()
    if kind < 0.3:
        shape = [box(0.03, 0.1, 0.5 * wide, 0.12, 0.65, METAL, 0.7)]
    elif kind < 0.7:
        low = rng.uniform(0.8, 1.6)
        shape = [
            box(
                0.0,
                0.03,
                0.5 * wide,
                low,
                min(low + rng.uniform(0.3, 1.2), high),
                rng.choice((MATT, PAINT)),
                _tone(rng),
            )
        ]
    elif kind < 0.85:
        shape = [box(0.0, 0.15, 2.0 * wide, high - rng.uniform(0.15, 0.5), high - 0.1, METAL, 0.4)]
    else:
        shape = [ellipsoid((0.06, 0.12 * k, 0.5 * high), (0.06, 0.07, 0.52 * high), CLOTH, 0.5) for k in range(-3, 4)]
        wide = 0.9
    return shape, (0.0, 0.16, 0.5 * wide), WALL if kind > 0.7 else THING


def cart(rng: Random) -> tuple[Shape, float, float]:
    """A robot, trolley or vacuum cleaner that goes by itself: (shape, length, width)."""
    kind = rng.random()
    if kind < 0.2:
        return [frustum(0.01, 0.1, -0.17, 0.17, -0.16, 0.16, 0.17, 0.16, MATT, _tone(rng))], 0.35, 0.35
    long, wide, high = rng.uniform(0.4, 1.2), rng.uniform(0.4, 0.8), rng.uniform(0.25, 0.6)
    shape = [box(-0.5 * long, 0.5 * long, 0.5 * wide, 0.05, high, PAINT, _tone(rng))]
    if kind < 0.6:
        shape.append(capsule((-0.3 * long, 0, high), (-0.3 * long, 0, rng.uniform(0.8, 1.6)), 0.05, METAL, 0.3))
        shape.append(box(-0.35 * long, -0.25 * long, 0.15, 1.0, 1.25, MATT, _tone(rng)))
    elif kind < 0.85:
        shape.append(box(-0.4 * long, 0.4 * long, 0.4 * wide, high, high + rng.uniform(0.3, 1.2), MATT, _tone(rng)))
    return shape, long, wide


def fork_lift(rng: Random) -> tuple[Shape, float, float]:
    """A fork lift with its driver, perhaps with a load."""
    tone, reach = _tone(rng), rng.uniform(0.1, 1.8)
    shape = [
        box(-1.1, 0.7, 0.5, 0.15, 0.9, PAINT, tone),
        box(-0.9, 0.5, 0.45, 2.0, 2.1, METAL, 0.2),
        *(capsule((x, y, 0.9), (x, y, 2.0), 0.04, METAL, 0.2) for x in (-0.85, 0.45) for y in (-0.42, 0.42)),
        *(box(0.75, 0.85, 0.05, 0.05, 2.2, METAL, 0.1, at=(0, y, 0)) for y in (-0.3, 0.3)),
        *(box(0.85, 1.9, 0.06, reach, reach + 0.05, METAL, 0.2, at=(0, y, 0)) for y in (-0.25, 0.25)),
        capsule((-0.35, 0, 1.0), (-0.3, 0, 1.5), 0.18, CLOTH, 0.3),
        ellipsoid((-0.28, 0, 1.78), (0.1, 0.08, 0.13), CLOTH, 0.3),
    ]
    if rng.random() < 0.5:
        shape.append(box(0.9, 1.9, 0.5, reach + 0.05, reach + rng.uniform(0.4, 1.3), MATT, _tone(rng)))
    return shape, 3.1, 1.1


def door(rng: Random, wide: float, tall: float) -> Shape:
    """The leaf of a door, hinged at the origin, along x."""
    return [
        box(0.0, wide, 0.022, 0.01, tall, rng.choice((MATT, PAINT, METAL)), rng.uniform(0.15, 0.8)),
        capsule((wide - 0.08, -0.07, 1.03), (wide - 0.08, 0.07, 1.03), 0.015, METAL, 0.4),
    ]


FREE = (table, table, chair, chair, boxes, plant, lamp, partition)
SIDE = (cupboard, cupboard, shelf, shelf, sofa, table, boxes, plant)
LARGE = (rack, rack, machine, boxes, table, partition, column)

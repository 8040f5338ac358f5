"""People on foot of all sizes and clothes, with knees and elbows that bend as they go, and what they carry or push."""

import math
from dataclasses import dataclass
from random import Random

from mos_model.simulator import vehicles
from mos_model.simulator.raycast import CLOTH, MATT, MESH
from mos_model.simulator.shapes import Numbers, Row, Shape, box, capsule, ellipsoid, frustum

HABITS = {  # what sets them apart, and how often
    "plain": 34, "coat": 10, "skirt": 6, "rucksack": 9, "bag": 7, "umbrella": 5, "trolley": 5, "bin": 2, "pram": 5,
    "dog": 4, "bicycle": 4, "wheelchair": 3, "phone": 6,
}  # fmt: skip
ALBEDOS = (0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.45, 0.6, 0.8)


@dataclass(frozen=True)
class Figure:
    """Somebody, and how that body moves as it goes."""

    shape: Shape
    length: float  # m
    width: float  # m
    stride: float = 1.45  # m, two steps
    phase: float = 0.0  # radians, of the stride
    bob: float = 0.0  # m, by which the body sinks between the steps
    sway: float = 0.0  # m, by which it leans over the foot that it stands on


def pedestrian(rng: Random, runs: bool = False, child: bool | None = None, indoors: bool = False) -> Figure:
    """Somebody on foot; a jogger if `runs`; of any age, or a `child`, or none; `indoors` without an umbrella."""
    child = rng.random() < 0.12 if child is None else child
    tall = rng.uniform(0.85, 1.45) if child else min(max(rng.gauss(1.7, 0.09), 1.45), 2.0)
    kind = "plain" if runs else rng.choices(tuple(HABITS), tuple(HABITS.values()))[0]
    if indoors and kind in ("umbrella", "bicycle", "bin"):
        kind = "plain"
    if child and kind in ("coat", "trolley", "bin", "pram", "wheelchair"):
        kind = "rucksack"
    if kind == "wheelchair":
        return Figure(_wheelchair(rng), 1.0, 0.7)
    k, wide = tall / 1.75, rng.uniform(0.85, 1.3)
    top, legs = _cloth(rng), _cloth(rng)
    amplitude = rng.uniform(0.55, 0.7) if runs else rng.uniform(0.27, 0.5)
    stride = k * (rng.uniform(2.0, 2.7) if runs else 3.4 * amplitude * rng.uniform(0.95, 1.1))
    phase = rng.uniform(0, 2 * math.pi)
    busy = {"pram": 2, "trolley": 1, "bin": 1, "umbrella": 1, "phone": 1, "bicycle": 2, "dog": 1}.get(kind, 0)
    pockets = busy == 0 and not runs and rng.random() < 0.12
    lean, hair = tall * rng.gauss(0.015, 0.02), rng.uniform(0.9, 1.35)
    skull = (0.1 * k * hair, 0.08 * k * hair, 0.07 * tall * min(hair, 1.15))
    shape = [ellipsoid((2 * lean + 0.02 * k, 0, 0.93 * tall), skull, CLOTH, rng.choice((0.05, 0.15, 0.3, 0.45)))]
    deep, half = 0.13 * k * wide, 0.2 * k * wide
    if rng.random() < 0.35:  # a jacket
        low, high = 0.5 * tall, rng.uniform(0.82, 0.85) * tall
        shape.append(frustum(low, high, -deep, deep, lean - deep, lean + 0.8 * deep, half, 0.85 * half, CLOTH, top))
    else:
        shape.append(ellipsoid((lean, 0, 0.68 * tall), (deep, half, 0.18 * tall), CLOTH, top))
    if kind in ("coat", "skirt"):
        low, high = (0.22, 0.7) if kind == "coat" else (rng.uniform(0.08, 0.35), 0.6)
        shape.append(
            frustum(low * tall, high * tall, -0.2 * k, 0.2 * k, -0.13 * k, 0.13 * k, 0.24 * k, 0.17 * k, CLOTH, top)
        )
    else:
        shape.append(ellipsoid((0, 0, 0.52 * tall), (0.12 * k * wide, 0.17 * k * wide, 0.08 * tall), CLOTH, legs))
    trousers, sleeves, vivid = rng.uniform(0.75, 1.5), rng.uniform(0.8, 1.6), rng.uniform(0.1, 1.0)
    toes = rng.uniform(0.0, 0.09)
    for side in (-1, 1):
        shape += _leg(
            side,
            k,
            wide * trousers,
            toes,
            legs,
            (side * amplitude, stride, phase),
            1.7 if runs else rng.uniform(0.6, 1.0),
        )
    for side in (1, -1):
        busy -= 1
        swing = (-vivid * side * amplitude, stride, phase)
        bend = 1.5 if runs else rng.uniform(0.1, 0.4)
        if busy >= 0:
            swing, bend = (0.0, 1.0, 0.0), rng.uniform(1.2, 1.8) if kind in ("umbrella", "phone") else 0.8
        if pockets:
            swing, bend = (0.0, 1.0, 0.0), 0.6
        shape += _arm(k, (1.6 * lean, 0.235 * side * k * wide, 0.8 * tall), 0.046 * k * sleeves, top, swing, bend)
    more, length, width = _extra(rng, kind, k, tall)
    bob = 0.09 if runs else rng.uniform(0.03, 0.055)
    return Figure(shape + more, length, width, stride, phase, k * bob, k * rng.uniform(0.01, 0.03))


def sitting(rng: Random, seat: float = 0.46) -> Shape:
    """Somebody on a seat of that height, m."""
    k, top, legs = rng.uniform(0.85, 1.08), _cloth(rng), _cloth(rng)
    lean = rng.uniform(-0.1, 0.3)
    shoulder = (0.5 * k * math.sin(lean), seat + 0.08 + 0.5 * k * math.cos(lean))
    shape = [
        ellipsoid((shoulder[0] + 0.03, 0, shoulder[1] + 0.22 * k), (0.1, 0.08, 0.13), CLOTH, 0.3),
        capsule((0, 0, seat + 0.12), (shoulder[0], 0, shoulder[1] - 0.1), 0.17 * k, CLOTH, top),
    ]
    for side in (-1, 1):
        y, knee = 0.11 * side * k, (0.44 * k, 0.14 * side, seat + 0.04)
        shape.append(capsule((0, y, seat + 0.06), knee, 0.08 * k, CLOTH, legs))
        shape.append(capsule(knee, (0.44 * k + rng.uniform(-0.15, 0.1), 0.14 * side, 0.06), 0.06 * k, CLOTH, legs))
        hand = (rng.uniform(0.25, 0.45), 0.15 * side, seat + rng.uniform(0.15, 0.35))
        shape.append(capsule((shoulder[0], 0.2 * side * k, shoulder[1]), hand, 0.05 * k, CLOTH, top))
    return shape


def _cloth(rng: Random) -> float:
    return 0.95 if rng.random() < 0.03 else rng.choice(ALBEDOS) * rng.uniform(0.8, 1.2)


def _hanging(row: Row, bend: float, fixed: float) -> Row:
    """A limb that hangs on the end of the one before it, see `placing.place`."""
    row[16:19] = [1.0, bend, fixed]
    return row


def _leg(side: int, k: float, wide: float, toes: float, albedo: float, swing: Numbers, bend: float) -> Shape:
    y = 0.1 * side * k
    hip, knee = (0.0, y, 0.88 * k), (0.0, y, 0.48 * k)
    return [
        capsule(hip, knee, 0.08 * k * wide, CLOTH, albedo, swing=swing),
        _hanging(capsule(knee, (toes, y, 0.06 * k), 0.055 * k * wide, CLOTH, albedo, swing=swing), -bend, 0.0),
    ]


def _arm(k: float, shoulder: Numbers, thick: float, albedo: float, swing: Numbers, bend: float) -> Shape:
    x, y, z = shoulder
    elbow = z - 0.29 * k
    return [
        capsule((x, y, z), (x, y, elbow), thick, CLOTH, albedo, swing=swing),
        _hanging(capsule((x, y, elbow), (x, y, elbow - 0.3 * k), 0.85 * thick, CLOTH, albedo, swing=swing), 0.0, bend),
    ]


def _extra(rng: Random, kind: str, k: float, tall: float) -> tuple[Shape, float, float]:
    """What somebody has along: its shape, and length and width of all."""
    tone = rng.choice(ALBEDOS)
    if kind == "rucksack":
        deep, high = rng.uniform(0.08, 0.16), rng.uniform(0.17, 0.3)
        return [ellipsoid((-0.14 * k - deep, 0, 0.7 * tall), (deep, 0.15 * k, high), CLOTH, tone)], 0.7, 0.6
    if kind == "bag":
        at, low = (0, rng.choice((-0.34, 0.34)) * k, 0), 0.12 * tall + rng.uniform(0, 0.15)
        return [box(-0.18, 0.18, 0.07, low, low + rng.uniform(0.2, 0.4), CLOTH, tone, at=at)], 0.5, 0.8
    if kind == "umbrella":
        high, half = 1.12 * tall + rng.uniform(-0.08, 0.12), rng.uniform(0.42, 0.65)
        return (
            [
                frustum(high - 0.14, high + 0.06, -half, half, -0.1, 0.1, half, 0.1, CLOTH, tone, at=(0.1, 0.1, 0)),
                capsule((0.25 * k, 0.2 * k, 0.62 * tall), (0.1, 0.1, high), 0.02, MATT, 0.2),
            ],
            1.0,
            1.1,
        )
    if kind in ("trolley", "bin"):
        long, wide, high = (0.22, 0.18, 0.62) if kind == "trolley" else (0.35, 0.27, 1.05)
        back = -0.55 - long
        return (
            [
                box(back - long / 2, back + long / 2, wide, 0.06, high, CLOTH if kind == "trolley" else MATT, tone),
                capsule((back, 0.1, high), (-0.1, 0.24 * k, 0.55 * tall), 0.02, MATT, 0.2),
            ],
            1.4,
            0.7,
        )
    if kind == "pram":
        return (
            [
                box(0.45, 1.1, 0.22, 0.5, 0.85, CLOTH, tone),
                ellipsoid((0.65, 0, 0.85), (0.25, 0.22, 0.25), CLOTH, tone),
                box(0.45, 1.1, 0.27, 0.0, 0.5, MESH, 0.15, p=(0.3, 0, 0)),
            ],
            1.6,
            0.7,
        )
    if kind == "dog":
        size, x, y = rng.uniform(0.5, 1.2), rng.uniform(-0.3, 0.9), rng.choice((-0.55, 0.55))
        return [
            ellipsoid((x, y, 0.45 * size), (0.38 * size, 0.13 * size, 0.14 * size), CLOTH, tone),
            ellipsoid((x + 0.45 * size, y, 0.6 * size), (0.16 * size, 0.08 * size, 0.1 * size), CLOTH, tone),
            *(
                capsule((x + u * size, y, 0.42 * size), (x + u * size, y, 0.04), 0.05 * size, CLOTH, tone,
                        swing=(0.5 * u, 0.7 * size, rng.uniform(0, 6)))
                for u in (-0.28, 0.28)
            ),
        ], 1.4, 1.2  # fmt: skip
    if kind == "bicycle":
        rows = vehicles.bicycle(rng)[0]
        for row in rows:
            row[2] += 0.5
        return rows, 1.8, 1.2
    return [], 0.5, 0.6


def _wheelchair(rng: Random) -> Shape:
    shape = sitting(rng, 0.5)
    shape += [ellipsoid((-0.05, y, 0.3), (0.3, 0.03, 0.3), MESH, 0.2, p=(0.5, 0, 0)) for y in (-0.3, 0.3)]
    shape.append(box(-0.22, -0.17, 0.22, 0.3, 0.95, CLOTH, 0.08))
    return shape

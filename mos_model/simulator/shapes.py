"""Shapes: lists of primitives (rows of `raycast`) in their own frame, x forward, y left, z up from the ground, m."""

import math
from collections.abc import Sequence

import numpy as np

from mos_model.simulator.raycast import CAPSULE, CLOTH, COLUMNS, ELLIPSOID, FRUSTUM, MATT, METAL

Numbers = Sequence[float]
Row = list[float]
Shape = list[Row]


def _row(
    kind: int,
    at: Numbers,
    yaw: float,
    geometry: Numbers,
    material: int,
    albedo: float,
    parameters: Numbers = (0.0, 0.0, 0.0),
    swing: Numbers = (0.0, 1.0, 0.0),
) -> Row:
    geometry = (*geometry, *(0.0,) * (8 - len(geometry)))
    return [kind, *at, math.cos(yaw), math.sin(yaw), *geometry, material, 0.0, *parameters, *swing, albedo]


def frustum(
    z0: float,
    z1: float,
    rear0: float,
    front0: float,
    rear1: float,
    front1: float,
    half0: float,
    half1: float,
    material: int = MATT,
    albedo: float = 0.3,
    at: Numbers = (0, 0, 0),
    yaw: float = 0.0,
    p: Numbers = (0, 0, 0),
) -> Row:
    """A box whose four sides may lean."""
    return _row(FRUSTUM, at, yaw, (z0, z1, rear0, front0, rear1, front1, half0, half1), material, albedo, p)


def box(
    x0: float,
    x1: float,
    half: float,
    z0: float,
    z1: float,
    material: int = MATT,
    albedo: float = 0.3,
    at: Numbers = (0, 0, 0),
    yaw: float = 0.0,
    p: Numbers = (0, 0, 0),
) -> Row:
    """A box from x0 to x1, `half` to both sides, z0 to z1."""
    return frustum(z0, z1, x0, x1, x0, x1, half, half, material, albedo, at, yaw, p)


def ellipsoid(
    centre: Numbers,
    radii: Numbers,
    material: int = CLOTH,
    albedo: float = 0.3,
    at: Numbers = (0, 0, 0),
    yaw: float = 0.0,
    p: Numbers = (0, 0, 0),
) -> Row:
    """An ellipsoid."""
    return _row(ELLIPSOID, at, yaw, (*centre, *radii), material, albedo, p)


def capsule(
    a: Numbers,
    b: Numbers,
    radius: float,
    material: int = METAL,
    albedo: float = 0.3,
    at: Numbers = (0, 0, 0),
    yaw: float = 0.0,
    p: Numbers = (0, 0, 0),
    swing: Numbers = (0, 1, 0),
) -> Row:
    """A rod with round ends from a to b; `swing` (rad, stride m, phase) moves b about a as it goes."""
    return _row(CAPSULE, at, yaw, (*a, *b, radius), material, albedo, p, swing)


def array(shape: Shape) -> np.ndarray:
    """The shape as (n, COLUMNS) float64."""
    return np.array(shape, np.float64).reshape(-1, COLUMNS)

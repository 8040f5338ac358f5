"""What a sensor sees of that which carries it: hood and roof, rack and masts, hull and arms. It is where it was in
every scan, and hides what is behind. Shapes are in the carrier's directions, x forward, the sensor at the origin, m."""

import math
from dataclasses import replace
from random import Random

import numpy as np

from mos_model.simulator import raycast, rays, shapes
from mos_model.simulator.boxes import bounds
from mos_model.simulator.mounting import ROBOT
from mos_model.simulator.raycast import MATT, METAL, PAINT
from mos_model.simulator.rig import HIDDEN, Rig
from mos_model.simulator.settings import SimulationSettings

IN_VIEW, MOST = 0.004, 0.4  # share of the firings that return from a body, and that it may stop at most
TRIES = 12
NEAREST = 0.3  # m, from where on some sensors report whatever their manuals say


def draw_body(seed: int, settings: SimulationSettings, rig: Rig) -> Rig:
    """The rig with its carrier in view, or as it was: by `settings`, or for a third of the rigs of version 2."""
    rng = Random(f"body {seed}")
    robot = rig.mount[0] < ROBOT
    wide = settings.version > 1 and settings.sensor_variation
    drawn = rng.random() < (0.55 if robot else 0.25)
    if not (settings.body if settings.body is not None else wide and drawn):
        return rig
    if rng.random() < 0.4:
        rig = replace(rig, nearest=min(rig.nearest, NEAREST))
    for _ in range(TRIES):
        shape = _robot(rng) if robot else _car(rng, float(rig.mount[0]))
        shape = [part for part in shape if rng.random() < 0.85]
        depth, cosine = look(shape, rig, rng.getrandbits(62))
        stopped = np.isfinite(depth)
        if np.mean(stopped & (depth >= rig.nearest)) >= IN_VIEW and np.mean(stopped) <= MOST:
            body, albedo = np.where(rig.body == HIDDEN, rig.body, depth), rng.choice((0.05, 0.2, 0.4, 0.7))
            return replace(rig, body=body, body_cosine=cosine, body_albedo=albedo)
    return rig


def look(shape: shapes.Shape, rig: Rig, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth m and cosine of incidence, (columns, beams) float32, of a shape that travels with the sensor."""
    size, columns = (rig.profile.azimuth_steps, rig.profile.beams), rig.profile.azimuth_steps
    azimuth, still = rays.firing_ticks(columns, rig.profile.encoder_steps, 0.5), np.zeros((3, 6))
    world, slope = np.empty((*size, 3), np.float32), np.empty(size, np.float32)
    origin, level, phase = np.empty((columns, 3)), np.empty((columns, 3)), np.empty(columns)
    local = rays.local_rays(azimuth, rig.elevation, rig.offset)
    rays.world_rays(local, azimuth, still, world, slope, origin, level, phase)
    depth, hit = np.full(size, np.inf, np.float32), np.full(size, -1, np.int32)
    cosine = np.zeros(size, np.float32)
    parts = shapes.array(shape)
    turn = np.array(
        ((math.cos(rig.mount[3]), math.sin(rig.mount[3])), (-math.sin(rig.mount[3]), math.cos(rig.mount[3])))
    )
    parts[:, 1:3] = parts[:, 1:3] @ turn.T  # the sensor's own directions
    parts[:, 4:6] = parts[:, 4:6] @ turn.T
    raycast.cast_primitives(
        parts, bounds(parts), np.arange(len(parts)), np.zeros((1, 2)), world, slope, origin, level, phase, rig.drop,
        np.tan(rig.elevation), still, 0.0, seed, depth, hit, cosine,
    )  # fmt: skip
    depth[np.isfinite(depth) & (hit == -1)] = HIDDEN  # mirrored away
    return depth, cosine


def _car(rng: Random, height: float) -> shapes.Shape:
    """The roof that the sensor stands on, with a rack and what else is on it, and the hood."""
    below = rng.choice((rng.uniform(0.08, 0.25), rng.uniform(0.25, 0.7)))
    front, rear, half = rng.uniform(0.3, 1.5), rng.uniform(0.5, 2.6), rng.uniform(0.5, 0.75)
    roof = max(below, height - 2.6)
    shape = [shapes.frustum(-roof - 0.1, -roof, -rear - 0.1, front + 0.2, -rear, front, half + 0.1, half, PAINT)]
    if rng.random() < 0.6:
        bonnet = max(height - rng.uniform(0.85, 1.15), roof + 0.2)
        shape.append(shapes.box(front + 0.5, front + rng.uniform(1.5, 2.2), 0.8, -bonnet - 0.2, -bonnet, PAINT))
    if rng.random() < 0.6:
        for x in (rng.uniform(0.35, 1.0), -rng.uniform(0.35, 1.0)):
            z = rng.uniform(0.03, 0.15) - roof
            shape.append(shapes.box(x - 0.03, x + 0.03, half, z - 0.04, z, METAL))
    if rng.random() < 0.2:
        x, long = -rng.uniform(0.4, 0.8), rng.uniform(0.5, 1.5)
        box = shapes.box(x - long, x, rng.uniform(0.2, 0.5), -roof, -roof + rng.uniform(0.1, 0.45), MATT)
        shape.append(box)
    return shape + _masts(rng, -roof, rng.choice((0, 1, 1, 2, 4)))


def _robot(rng: Random) -> shapes.Shape:
    """The hull below, with a wall, masts, arms, or who carries or pushes it behind."""
    below, half = rng.uniform(0.06, 0.4), rng.uniform(0.15, 0.45)
    front, rear = rng.uniform(0.1, 0.7), rng.uniform(0.2, 1.0)
    shape = [shapes.frustum(-below - 0.3, -below, -rear, front, -rear, front, half, half, rng.choice((MATT, PAINT)))]
    if rng.random() < 0.35:  # the sensor sits low before a higher hull
        wall = rng.uniform(0.33, 0.7)
        shape.append(shapes.box(-wall - 0.3, -wall, half, -below, rng.uniform(-0.05, 0.6)))
    if rng.random() < 0.3:
        for side in (-1, 1):
            reach, out = rng.uniform(0.4, 1.1), side * rng.uniform(0.25, 0.5)
            shape.append(shapes.capsule((0.0, out, -below - 0.1), (reach, out, rng.uniform(-0.4, 0.2)), 0.06))
    if rng.random() < 0.25:  # a person
        x, y, top = -rng.uniform(0.4, 1.6), rng.uniform(-0.4, 0.4), rng.uniform(-0.1, 0.9)
        shape.append(shapes.ellipsoid((x, y, top - 0.6), (0.15, 0.26, 0.42)))
        shape.append(shapes.ellipsoid((x, y, top), (0.1, 0.09, 0.13)))
    return shape + _masts(rng, -below, rng.choice((0, 1, 2, 4)))


def _masts(rng: Random, foot: float, count: int) -> shapes.Shape:
    """Poles and boxes that stand beside the sensor."""
    shape = []
    for _ in range(count):
        angle, away, radius = rng.uniform(-math.pi, math.pi), rng.uniform(0.38, 1.2), rng.uniform(0.01, 0.06)
        x, y, top = away * math.cos(angle), away * math.sin(angle), rng.uniform(-0.05, 0.8)
        if rng.random() < 0.6:
            shape.append(shapes.capsule((x, y, foot), (x, y, top), radius))
        else:
            half = rng.uniform(0.03, 0.12)
            shape.append(shapes.box(-half, half, half, foot, 0.3 * top, at=(x, y, 0.0), yaw=angle))
    return shape

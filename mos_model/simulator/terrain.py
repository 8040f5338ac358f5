"""The ground of one sequence: heights and surfaces around the roads."""

import math
from random import Random
from typing import Protocol

import numpy as np

from mos_model.simulator.ground import (
    COARSE,
    PAVED,
    SIDEWALK,
    TERRAIN,
    bilinear,
    bilinear_many,
    paint_roads,
    pave,
)
from mos_model.simulator.roads import Road
from mos_model.simulator.streets import StreetStyle

REACH = 85.0  # m, how far from the sensor's way the world goes
FAR = 30.0  # m, distances from the road are not told apart beyond


class Ground(Protocol):
    """What one drives and walks on."""

    def heights_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights (n,) of the ground, m."""


class Terrain:
    """Grids of heights and surface classes; coordinates in m, z up."""

    def __init__(self, rng: Random, style: StreetStyle, roads: list[Road], way: np.ndarray) -> None:
        """The ground within REACH of `way` (n, 2), the points that the sensor passes."""
        corner, end = way.min(axis=0) - REACH - 30, way.max(axis=0) + REACH + 30
        self.x0, self.y0 = float(corner[0]), float(corner[1])
        nx, ny = (end - corner).astype(int) + 2
        self.edge = np.full((ny, nx), FAR, np.float32)  # m to the nearest road's edge, COARSE m apart
        paint_roads(self.edge, self.x0, self.y0, COARSE, np.concatenate([r.segments() for r in roads]), FAR)
        base = self._draw_base(rng)
        self.cell = 0.25 if nx * ny < 120_000 else 0.5  # m
        shape = int(ny / self.cell), int(nx / self.cell)
        self.height, self.surface = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        self.walk, self.strip = rng.uniform(*style.walk), rng.uniform(*style.strip)
        bank = rng.gauss(0, 0.12) if rng.random() < 0.5 else 0.0
        built_up = style.buildings >= 0.8
        beyond = rng.choice((PAVED, SIDEWALK)) if built_up else rng.choice((TERRAIN, TERRAIN, PAVED))
        kerb = rng.choice((0.0, 0.06, 0.12, 0.15)) if style.walk[1] > 2 else 0.0
        pave_style = (
            self.walk, kerb, self.strip, bank, rng.uniform(0.3, 4.0), float(rng.choice((TERRAIN, SIDEWALK))),
            float(beyond), rng.choice((0.0, 1.0)),
        )  # fmt: skip
        pave(self.height, self.surface, self.cell, self.edge, base, pave_style)
        self.highest = float(self.height.max())

    def _draw_base(self, rng: Random) -> np.ndarray:
        """Slope, hills and, off the roads, bumps, on the coarse grid."""
        gx, gy = np.meshgrid(np.arange(self.edge.shape[1]), np.arange(self.edge.shape[0]))
        base = rng.gauss(0, 0.012) * gx + rng.gauss(0, 0.012) * gy
        hilly = rng.choice((0.0, 0.3, 0.8, 2.0)) if rng.random() < 0.7 else 0.0
        for _ in range(3):
            angle, wave = rng.uniform(0, 6.28), rng.uniform(60, 200)
            phase = (math.cos(angle) * gx + math.sin(angle) * gy) * (2 * math.pi / wave) + rng.uniform(0, 6.28)
            base = base + hilly * np.sin(phase)
        noise = np.random.default_rng(rng.getrandbits(32))
        bumps = rng.choice((0.0, 0.02, 0.06)) * noise.standard_normal(self.edge.shape)
        return base + np.where(self.edge > 3.0, bumps, 0.0)

    def height_at(self, x: float, y: float) -> float:
        """Height of the ground, m."""
        return float(bilinear(self.height, self.x0, self.y0, self.cell, x, y))

    def heights_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights (n,) of the ground, m."""
        heights: np.ndarray = bilinear_many(self.height, self.x0, self.y0, self.cell, x, y)
        return heights

    def edge_at(self, x: float, y: float) -> float:
        """Distance from the nearest road's edge, m; negative on a road."""
        return float(bilinear(self.edge, self.x0, self.y0, COARSE, x, y))

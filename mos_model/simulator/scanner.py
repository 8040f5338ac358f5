"""One sweep of the sensor through a scene."""

import math

import numpy as np

from mos_model.simulator import airborne, ground, placing, raycast, rays, returns
from mos_model.simulator.rig import Rig
from mos_model.simulator.scene import Scene
from mos_model.simulator.weather import Weather, spray

SURFACE_LABELS = np.array((40, 60, 48, 72, 49, 99, 99), np.uint32)  # ROAD, MARKING, SIDEWALK, TERRAIN, PAVED, AIR, BODY
# Share of returns lost, by material: MATT, FACADE, BARS, MESH, FOLIAGE, PAINT, CABIN, CLOTH, METAL.
MATERIAL_LOSS = np.array((0.0, 0.01, 0.04, 0.08, 0.03, 0.03, 0.03, 0.01, 0.01))
RADII = 1.6 * 1.035 ** np.arange(125)  # m, where the ground is looked up along a column
NEAR = 0.2 * 1.15 ** np.arange(15)  # m, and where besides, if beams end there


class Scanner:
    """A rig in its weather, with the buffers of its sweeps."""

    def __init__(self, rig: Rig, weather: Weather) -> None:
        self.rig, self.weather = rig, weather
        self._albedo = np.append(rig.albedo, (weather.albedo, rig.body_albedo))
        self._hidden = rig.body < rig.nearest
        self._body = np.where(self._hidden, np.float32(np.inf), rig.body)
        columns, beams = rig.profile.azimuth_steps, rig.profile.beams
        self._tangents = np.tan(rig.elevation)
        self._rays = np.empty((columns, beams, 3), np.float32)
        self._slope, self._depth, self._cosine = (np.empty((columns, beams), np.float32) for _ in range(3))
        self._hit = np.empty((columns, beams), np.int32)
        self._origin, self._level, self._phase = (
            np.empty((columns, 3)),
            np.empty((columns, 3)),
            np.empty(columns),
        )
        steepest = math.tan(max(abs(rig.mount[1]) + abs(rig.mount[2]) - float(rig.elevation[-1]), 0.01))
        nearest = float(rig.mount[0]) / steepest  # m, where the ground begins
        radii = np.concatenate([NEAR, RADII]) if nearest < 1.1 * RADII[0] else RADII
        self._radii = radii[: np.searchsorted(radii, rig.profile.max_range) + 1]

    def scan(
        self,
        scene: Scene,
        states: np.ndarray,
        guess: np.ndarray | None,
        duration: float,
        imperfect: bool,
        seed: list[int],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 4) float32 and labels (n,) uint32 of one sweep of `duration` s.

        `states` (3, 6): the sensor at its start, middle and end. With `guess`, states that the sensor is
        believed to have had, points are brought to the middle of the sweep; without, they stay as recorded.
        """
        rig, profile, terrain = self.rig, self.rig.profile, scene.world.terrain
        shot = self._origin, self._level
        azimuth = rays.firing_ticks(profile.azimuth_steps, profile.encoder_steps, seed[0] % 1000 / 1000.0)
        local = rays.local_rays(azimuth, rig.elevation, rig.offset)
        rays.world_rays(local, azimuth, states, self._rays, self._slope, *shot, self._phase)
        ground.cast_ground(
            self._rays, self._slope, *shot, rig.drop, terrain.height, terrain.surface, terrain.x0, terrain.y0,
            terrain.cell, terrain.highest, self._radii, rig.rough, seed[1], self._depth, self._hit,
        )  # fmt: skip
        away = placing.distances(scene.prims, scene.boxes, states[1, 0], states[1, 1])
        order = np.argsort(away, kind="stable")[: np.count_nonzero(away < profile.max_range + 2.0)]
        raycast.cast_primitives(
            scene.prims, scene.boxes, order, scene.velocity, self._rays, self._slope, *shot, self._phase, rig.drop,
            self._tangents, states, duration, seed[2], self._depth, self._hit, self._cosine,
        )  # fmt: skip
        if rig.body_cosine is not None:
            nearer = self._body < self._depth
            self._depth[nearer], self._hit[nearer] = self._body[nearer], returns.BODY
            self._cosine[nearer] = rig.body_cosine[nearer]
        if self.weather.kind != "clear":
            self._cast_air(scene, states[1], seed[4])
        report: tuple[np.ndarray, np.ndarray] = returns.report(
            self._depth, self._hit, self._cosine, scene.prims, scene.labels, SURFACE_LABELS, self._albedo,
            MATERIAL_LOSS, local, self._rays, rig.drop, self._restoring(guess), self._hidden, rig.bias,
            np.array((rig.nearest, profile.max_range)), rig.noise, rig.sensitivity,
            self.weather.extinction, rig.loss, rig.stray if imperfect else 0.0,
            profile.remission_step, imperfect, seed[3],
        )  # fmt: skip
        return report

    def _cast_air(self, scene: Scene, state: np.ndarray, seed: int) -> None:
        """What firings meet in the air before their targets."""
        air, drop, found = self.weather, self.rig.drop, (self._depth, self._hit, self._cosine)
        drift = np.array(air.wind) * (scene.frame / self.rig.profile.rate)
        near = max(air.near, self.rig.nearest)
        airborne.cast_haze(
            self._rays, self._origin, drop, air.thickness, air.cell, drift, air.share, air.gain, near, air.scale,
            air.reach, air.outshone, air.surface, seed, *found,
        )  # fmt: skip
        puffs = np.concatenate([air.puffs + np.array((*drift, 0, 0)), spray(air, scene, state)])
        airborne.cast_puffs(
            self._rays, self._origin, self._level, drop, puffs, air.thickness, air.cell, drift, near, seed >> 1, *found
        )

    def _restoring(self, guess: np.ndarray | None) -> np.ndarray:
        """(columns, 3, 4) what takes a point measured at a column to the frame of the scan."""
        if guess is None:
            return np.tile(np.eye(4)[:3], (len(self._phase), 1, 1))
        transforms: np.ndarray = rays.restoring(guess, self._phase)
        return transforms

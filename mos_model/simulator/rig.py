"""The sensor of one sequence: its profile, and how this one differs from it."""

import math
from dataclasses import dataclass
from random import Random

import numpy as np

from mos_model.simulator.mounting import Mounting
from runtime.sensors.sensor import Sensor

AS_USUAL = Mounting()
HIDDEN = -1.0


@dataclass(frozen=True)
class Rig:
    """A mounted sensor. Per beam from the highest down; surfaces as in `ground`."""

    profile: Sensor
    mount: np.ndarray  # (4,) height above the ground m; pitch, roll and yaw in the vehicle, radians
    elevation: np.ndarray  # (beams,) radians
    offset: np.ndarray  # (beams,) radians, azimuth of the beam beside that of the firing
    bias: np.ndarray  # (beams,) m, constant range error
    drop: np.ndarray  # (beams,) m, by which the optics sit below the sensor's origin
    body: np.ndarray  # (columns, beams) float32 m to the vehicle itself; HIDDEN: ends there without return, inf: passes
    nearest: float  # m, there is no return from less
    noise: float  # m, of a range
    loss: float  # share of firings without return
    stray: float  # share of firings with a senseless return
    sensitivity: float  # see Sensor
    albedo: np.ndarray  # (surfaces,) of the ground
    rough: np.ndarray  # (surfaces,) m, height of what grows on it
    body_cosine: np.ndarray | None = None  # (columns, beams) float32, of incidence on the vehicle; None: out of view
    body_albedo: float = 0.3


def draw_rig(rng: Random, profile: Sensor, vary: bool, mounting: Mounting = AS_USUAL) -> Rig:
    """The sensor as its profile says, or one that differs in mounting, alignment, noise and sensitivity."""
    noise = np.random.default_rng(rng.getrandbits(32))
    bias = profile.beam_bias * noise.standard_normal(profile.beams)
    elevation = np.radians(np.array(profile.elevations))
    drop = -np.repeat(np.array(profile.lifts), profile.beams // len(profile.lifts))
    albedo, rough = np.array((0.2, 0.6, 0.3, 0.35, 0.25)), np.array((0.0, 0.0, 0.0, 0.1, 0.0))
    body = np.full((profile.azimuth_steps, profile.beams), np.inf, np.float32)
    if not vary:
        mount = _mount(mounting, profile.mount_height, 0.0, 0.0)
        return Rig(
            profile, mount, elevation, np.zeros(profile.beams), bias, drop, body, profile.min_range,
            profile.range_noise, profile.dropout, 0.0, profile.sensitivity, albedo, rough,
        )  # fmt: skip
    middle = elevation.mean()
    elevation = middle + (elevation - middle) * (1 + 0.03 * noise.uniform(-1, 1))
    elevation += np.radians(noise.uniform(-0.4, 0.4) + 0.05 * noise.standard_normal(profile.beams))
    elevation = np.sort(elevation)[::-1].copy()
    tilt = math.radians(rng.gauss(0, 0.5)), math.radians(rng.gauss(0, 0.5))
    rough[3] = rng.choice((0.03, 0.1, 0.2, 0.35))
    if profile.self_hidden and rng.random() < 0.8:
        hidden = _draw_hidden(rng, profile, elevation)
        body[np.roll(hidden, -round(mounting.yaw / (2 * math.pi) * profile.azimuth_steps), axis=0)] = HIDDEN
    return Rig(
        profile=profile,
        mount=_mount(mounting, profile.mount_height + rng.uniform(-0.15, 0.25), *tilt),
        elevation=elevation,
        offset=np.radians(noise.uniform(-0.1, 0.1, profile.beams)),
        bias=bias,
        drop=drop,
        body=body,
        nearest=profile.min_range,
        noise=profile.range_noise * rng.choice((0.6, 0.8, 1.0, 1.0, 1.8)) * mounting.noise,
        loss=profile.dropout * rng.choice((0.2, 0.5, 1.0, 1.0, 4.0)),
        stray=rng.choice((0.0, 0.0, 2e-5, 2e-4)),
        sensitivity=profile.sensitivity * rng.uniform(0.5, 2.0),
        albedo=albedo * noise.uniform(0.6, 1.4, 5),
        rough=rough,
    )


def _mount(mounting: Mounting, height: float, pitch: float, roll: float) -> np.ndarray:
    """The place of the sensor, where `mounting` does not say: as given."""
    chosen = mounting.height, mounting.pitch, mounting.roll
    usual = height, pitch, roll
    return np.array([b if a is None else a for a, b in zip(chosen, usual, strict=True)] + [mounting.yaw])


def _draw_hidden(rng: Random, profile: Sensor, elevation: np.ndarray) -> np.ndarray:
    """(columns, beams) rays that roof, racks and cameras of the vehicle stop: wedges of the lowest."""
    azimuth = np.arange(profile.azimuth_steps) * (360.0 / profile.azimuth_steps)
    wedges = [
        (180.0, rng.uniform(10, 50), rng.uniform(-21, -17)),
        (0.0, rng.uniform(10, 60), rng.uniform(-23, -19)),
    ]
    for _ in range(rng.randint(1, 6)):
        wedges.append((rng.uniform(0, 360), rng.uniform(2, 14), rng.uniform(-23, -15)))
    limit = np.full(profile.azimuth_steps, -90.0)
    for centre, half, top in wedges:
        away = np.abs((azimuth - centre + 180) % 360 - 180) / half
        limit = np.maximum(limit, np.where(away < 1, top - 5 * np.maximum(away - 0.6, 0) ** 2 / 0.16, -90.0))
    limit += np.random.default_rng(rng.getrandbits(32)).normal(0, 0.25, profile.azimuth_steps)
    hidden: np.ndarray = np.degrees(elevation)[None] < limit[:, None]
    return hidden

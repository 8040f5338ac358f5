"""Weather: what hangs in the air returns some firings and dims the rest. In the labels it is static, no object."""

import math
from dataclasses import dataclass, field
from random import Random

import numpy as np

from mos_model.simulator.scene import Scene
from mos_model.simulator.settings import WEATHERS, SimulationSettings

USUAL = (78, 9, 6, 4, 3)  # percent of the sequences of version 2 with each of WEATHERS
SIDE = 64  # cells of the field of thickness
SPRAYING = 5.0  # m/s, from which on the wheels of a vehicle throw up water


@dataclass(frozen=True)
class Weather:
    """The weather of one sequence. In the air: evenly, but for the field of thickness, and in puffs."""

    kind: str  # one of WEATHERS
    share: float = 0.0  # of the firings with nothing behind that meet the air
    near: float = 1.0  # m, the least range of such a return
    scale: float = 4.0  # m, mean way beyond
    reach: float = 20.0  # m, there are none farther away
    outshone: float = 0.0  # m, a target so near outshines half of them
    surface: float = 0.0  # 0: they end anywhere in it, 1: where it is thick enough, as on a surface
    extinction: float = 0.0  # 1/m, of the light on its way, forth and again back
    albedo: float = 0.1  # of the returns' remission
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m/s
    spray: float = 0.0  # chance of a firing to end in the spray behind a fast vehicle
    gain: np.ndarray = field(default_factory=lambda: np.ones(0))  # (beams,) how much each laser sees of the air
    thickness: np.ndarray = field(default_factory=lambda: np.ones((1, 1, 1), np.float32))  # (n, n, n) mean 1, repeated
    cell: float = 0.5  # m, of the thickness
    puffs: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))  # (n, 5) see `cast_puffs`; at time 0


def draw_weather(seed: int, settings: SimulationSettings, beams: int, way: np.ndarray) -> Weather:
    """The weather of a sequence, of draws of its own. `way` (frames, >=3) m: where the sensor comes along."""
    rng = Random(f"weather {seed}")
    drawn = rng.choices(WEATHERS, USUAL)[0]
    kind = settings.weather if settings.weather != "random" else drawn if settings.version > 1 else "clear"
    if kind == "clear":
        return Weather(kind)
    noise = np.random.default_rng(rng.getrandbits(32))
    heading, speed = rng.uniform(0, 2 * math.pi), rng.uniform(0.2, 3.0)
    wind = speed * math.cos(heading), speed * math.sin(heading), rng.gauss(0, 0.1)
    gain = np.exp(noise.normal(0, rng.uniform(0.0, 0.5), beams))
    if kind == "fog":
        thick, clumps, cell = rng.random(), _clumps(noise, rng.uniform(0.1, 1.8)), rng.uniform(0.15, 0.8)
        share = rng.choice((_log_uniform(rng, 0.1, 1.0), rng.uniform(0.8, 1.0)))
        surface = rng.choice((0.0, rng.random(), rng.uniform(0.8, 1.0), 1.0))
        return Weather(
            kind, share, rng.uniform(0.5, 3.0), _log_uniform(rng, 1.0, 10.0), 40.0,
            rng.choice((0.0, rng.uniform(0.0, 15.0))), surface, 0.006 * 12**thick, rng.uniform(0.0, 0.12), wind, 0.0,
            gain, clumps, cell, _draw_puffs(rng, rng.choice((0, 0, 4, 12)), way, 4.0),
        )  # fmt: skip
    if kind == "dust":
        share = rng.choice((0.0, _log_uniform(rng, 0.001, 0.05)))
        return Weather(
            kind, share, rng.uniform(0.8, 2.0), rng.uniform(2.0, 8.0), 30.0, 0.0, 0.0, rng.uniform(0.0, 0.01),
            rng.uniform(0.05, 0.15), wind, 0.0, gain, _clumps(noise, rng.uniform(0.5, 1.2)), rng.uniform(0.1, 0.3),
            _draw_puffs(rng, rng.randint(2, 14), way, 1.0),
        )  # fmt: skip
    least, most = (0.0005, 0.01) if kind == "rain" else (0.001, 0.03)
    return Weather(
        kind, _log_uniform(rng, least, most), rng.uniform(0.8, 2.0), rng.uniform(2.0, 7.0), 20.0, 0.0, 0.0,
        _log_uniform(rng, 0.001, 0.015), rng.uniform(0.02, 0.1) if kind == "rain" else rng.uniform(0.05, 0.2), wind,
        rng.choice((0.0, rng.uniform(0.1, 0.6))), gain,
    )  # fmt: skip


def spray(weather: Weather, scene: Scene, state: np.ndarray) -> np.ndarray:
    """Puffs (n, 5), as in Weather, that follow the fast vehicles within 40 m of a sensor at `state` (x, y, ...) m."""
    puffs = []
    for track in scene.tracks if weather.spray > 0 else ():
        x, y, yaw, speed = track.states[scene.frame, :4].tolist()
        if speed < SPRAYING or track.length < 2.5 or math.hypot(x - state[0], y - state[1]) > 40:
            continue
        for behind, radius, part in ((0.3, 0.9, 1.0), (1.8, 1.2, 0.6), (4.0, 1.5, 0.3)):
            away = 0.5 * track.length + behind
            px, py = x - away * math.cos(yaw), y - away * math.sin(yaw)
            chance = weather.spray * part * min(speed / 20.0, 1.0)
            puffs.append((px, py, scene.world.terrain.height_at(px, py) + 0.4 * radius, radius, chance))
    return np.array(puffs).reshape(-1, 5)


def _draw_puffs(rng: Random, count: int, way: np.ndarray, close: float) -> np.ndarray:
    """(count, 5) clouds along the `way`, from `close` m beside the sensor's place at some time."""
    puffs = []
    for _ in range(count):
        x, y, z = way[rng.randrange(len(way)), :3].tolist()
        radius, angle = rng.uniform(0.6, 4.0), rng.uniform(0, 2 * math.pi)
        away = close + radius * 0.5 + rng.expovariate(1 / 6)
        height = z - 1.5 + rng.uniform(0.0, 1.2) * radius
        puffs.append((x + away * math.cos(angle), y + away * math.sin(angle), height, radius, rng.uniform(0.1, 0.9)))
    return np.array(puffs).reshape(-1, 5)


def _clumps(noise: np.random.Generator, contrast: float) -> np.ndarray:
    """(SIDE, SIDE, SIDE) float32, mean 1: smooth noise that repeats; even at contrast 0, loose clouds from 1 on."""
    k = np.fft.fftfreq(SIDE)
    square = k[:, None, None] ** 2 + k[None, :, None] ** 2 + np.fft.rfftfreq(SIDE)[None, None] ** 2
    spectrum = np.fft.rfftn(noise.standard_normal((SIDE, SIDE, SIDE))) / (square + 0.03**2) ** 1.25
    spectrum[0, 0, 0] = 0.0
    wave = np.fft.irfftn(spectrum, s=(SIDE, SIDE, SIDE), axes=(0, 1, 2))
    thickness = np.exp(contrast * wave / wave.std())
    scaled: np.ndarray = (thickness / thickness.mean()).astype(np.float32)
    return scaled


def _log_uniform(rng: Random, least: float, most: float) -> float:
    return math.exp(rng.uniform(math.log(least), math.log(most)))

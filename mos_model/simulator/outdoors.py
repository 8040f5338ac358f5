"""A sequence in a street: its roads and houses, the sensor's way, and the traffic; more of that in version 2."""

from random import Random

import numpy as np

from mos_model.simulator.crowd import Crowd
from mos_model.simulator.drive import Drive
from mos_model.simulator.manoeuvres import add_manoeuvres, add_scooters
from mos_model.simulator.mounting import Mounting
from mos_model.simulator.settings import Conditions
from mos_model.simulator.streets import STYLES
from mos_model.simulator.terrain import Terrain
from mos_model.simulator.traffic import MOST, PERSON, Traffic, keep_apart
from mos_model.simulator.world import World

MANY = 80  # tracks of a sequence in version 2


def outdoors(
    seed: int, rng: Random, conditions: Conditions, times: np.ndarray, mounting: Mounting, version: int
) -> Traffic:
    """Draw a street and what moves there; `times` (frames,) s. Version 1 draws from `rng` alone."""
    style = STYLES[conditions.street]
    drive = Drive(rng, conditions.street, conditions.ego, times, mounting)
    way = drive.way()
    terrain = Terrain(rng, style, drive.roads, way[:, :2])
    world = World(rng, style, drive.roads, terrain, way, mounting.body)
    traffic = Traffic(rng, world, drive, conditions.density)
    if version > 1 and conditions.density > 0:
        _enrich(seed, traffic, conditions.street)
    traffic.tracks = keep_apart(traffic.tracks, traffic.ego, mounting.size, MOST if version == 1 else MANY)
    return traffic


def _enrich(seed: int, traffic: Traffic, street: str) -> None:
    """Give the traffic of a `street` other people, more vehicles and, in some towns, crowds of scooters."""
    rng = Random(f"variety {seed}")
    usual = [track for track in traffic.tracks if track.labels != PERSON]
    traffic.rng, traffic.tracks = rng, []
    scooters = street == "urban" and rng.random() < 0.12
    add_manoeuvres(rng, traffic)
    if scooters:
        add_scooters(rng, traffic)
        traffic.tracks.sort(key=lambda track: float(np.hypot(*(track.states[:, :2] - traffic.ego[:, :2]).T).min()))
    people = Crowd(Random(f"crowd {seed}"), traffic).tracks
    first = people[: MANY // 3] if scooters else people
    traffic.tracks = first + traffic.tracks + usual

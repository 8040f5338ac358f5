"""What version 2 adds to a street: its people and the vehicles that are hard to see."""

from random import Random

import numpy as np

from mos_model.simulator.crowd import Crowd
from mos_model.simulator.manoeuvres import add_manoeuvres, add_scooters
from mos_model.simulator.traffic import PERSON, Traffic

MOST = 80  # tracks in a sequence


def enrich(seed: int, traffic: Traffic, street: str) -> None:
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
    first = people[: MOST // 3] if scooters else people
    traffic.tracks = first + traffic.tracks + usual

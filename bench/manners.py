"""What each mover of a simulated drive does beside the sensor: the simulator knows, labels do not say."""

import math

import numpy as np

from mos_model.simulator.scene import MOVING_SPEED, STANDING_SPEED
from mos_model.simulator.sequence import Simulation

STARTS, CROSSES, SAME, ONCOMING, IN_PLACE = "starting", "crossing", "same direction", "oncoming", "moving in place"
MANNERS = (STARTS, CROSSES, SAME, ONCOMING, IN_PLACE)
RECENT = 1.0  # s: who stood so lately is starting, wherever it goes
ACROSS = math.radians(45)  # from the sensor's heading or its opposite: who goes on a wider angle is crossing


def manners(drive: Simulation, k: int) -> dict[int, str]:
    """One of MANNERS for each instance of the labels that moves in scan `k`.

    Of those that go: starting comes first, then the angle of the velocity to the sensor's heading. What stirs without
    going anywhere, as a person who stands and waves, moves in place.
    """
    ahead = drive.true_poses[k][:2, 0]  # the sensor's x axis, seen from above
    lately = slice(max(k - round(RECENT * drive.profile.rate), 0), k)
    found = {}
    for number, track in enumerate(drive.scene.tracks):
        speed, stir = track.states[:, 3], track.states[:, 7]
        if max(speed[k], stir[k]) <= MOVING_SPEED:
            continue
        way = track.states[min(k + 1, len(speed) - 1), :2] - track.states[max(k - 1, 0), :2]
        stood = bool((np.maximum(speed, stir)[lately] < STANDING_SPEED).any())
        found[drive.scene.instance(number)] = manner(way, ahead, stood, float(speed[k]))
    return found


def manner(way: np.ndarray, ahead: np.ndarray, stood: bool, speed: float) -> str:
    """Of a mover that goes along `way` (2,) at `speed` m/s, and stood lately or not; the sensor looks along `ahead`."""
    if stood:
        return STARTS
    if speed < STANDING_SPEED:
        return IN_PLACE
    turned = math.atan2(abs(float(ahead[0] * way[1] - ahead[1] * way[0])), float(ahead @ way))  # 0..pi
    return SAME if turned < ACROSS else ONCOMING if turned > math.pi - ACROSS else CROSSES

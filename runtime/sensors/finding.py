"""Which sensor measured a scan: the known one that has the beams that the scan shows, or one that is made of them."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.sensors.beams import Beams, look
from runtime.sensors.mounting import Pose, own_frame
from runtime.sensors.registry import SENSORS
from runtime.sensors.sensor import Sensor, even

FITS = 0.1  # misfit of a sensor that may be the one, at most
UNSEEN = 0.25  # share of its beams without a return, at most
FITS_WELL, UNSEEN_LEVEL = 0.03, 0.7  # the same where it fits well, and the lowest beams are there: others see but sky
SKY = 3.0  # degrees from the lowest beam of a sensor to the lowest that is seen, at most, if so
REGULAR = 0.45  # share of neighbours that are as far apart as beams are, at least: else none are to be told
TURN = 300.0  # degrees of azimuth with points, at least, where a sensor turns
SPEEDS = 0.5, 1.0, 2.0  # times the nominal
NONE = (math.inf, "")
NEARLY = 0.2  # logarithm of the firings over those of a sensor at such a speed, at most


@dataclass(frozen=True)
class Found:
    """The sensor of a scan."""

    sensor: Sensor
    nearest: str  # name of the known sensor that it is most like
    text: str  # what was seen, and what it was taken for
    mounting: Pose | None = None  # (4, 4) T_sensor_scan, where the scan is not in the sensor's own frame


def find_from_scan(scan: ArrayLike, ring: ArrayLike | None = None) -> Found | None:
    """The sensor of a scan (N, >=3), x, y, z in m; ring: (N,) number of the laser of each point, where it is known.

    None where too few points tell.
    """
    points = np.asarray(scan)
    seen = look(points, ring)
    if seen is None:
        return None
    angles, known = _best(seen)
    doubtful = known == NONE and seen.regular >= REGULAR
    seen, mounting = own_frame(points, ring, seen, doubtful)
    if mounting is not None:
        angles, known = _best(seen)
    low, high = float(angles[-1]), float(angles[0])
    text = f"about {len(angles)} beams, {low:.0f} to {high:.0f} degrees: "
    nearest = min(SENSORS, key=lambda name: _unlike(angles, SENSORS[name]))
    if seen.regular < REGULAR:
        sensor = Sensor("found", even(high, low, max(16, min(64, len(angles)))), round(seen.firings) or 1800)
        text += "hardly to be told apart, as in clouds that are merged, thinned out or moved; in rows at equal angles"
    elif known < NONE:
        sensor, nearest = _at_speed(SENSORS[known[1]], seen.firings), known[1]
        text += f"as {nearest}" + ("" if sensor.rate == SENSORS[nearest].rate else f" at {sensor.rate:g} Hz")
    else:
        sensor = Sensor("found", _falling(angles), round(seen.firings) or 1800)
        text += f"none that is known, much like {nearest}; in rows for the beams that are there"
    if mounting is not None:
        mounting[2, 3] += np.mean(sensor.lifts) * (mounting[2, 3] != 0)  # to where its own frame begins
        text += f"; {_said(mounting)}"
    if seen.turn < TURN:
        text += f"; a view {seen.turn:.0f} degrees wide, where networks expect a full turn"
    return Found(sensor, nearest, text, mounting)


def _best(seen: Beams) -> tuple[NDArray[np.float64], tuple[float, str]]:
    """Those angles of the beams that are more like those of a known sensor, and which."""
    known = _known(seen.angles, seen.firings)
    if seen.level is not None and (better := _known(seen.level, seen.firings, UNSEEN_LEVEL)) < known:
        return seen.level, better
    return seen.angles, known


def _known(angles: NDArray[np.float64], firings: float, unseen_well: float = UNSEEN) -> tuple[float, str]:
    """The name of the sensor whose beams these are, after what speaks against it; NONE if it is none."""
    costs = [NONE]
    for sensor in SENSORS.values():
        misfit, unseen = _misfit(angles, np.array(sensor.elevations))
        lowest = angles[-1] - sensor.elevations[-1] < SKY
        if misfit < FITS and unseen < (unseen_well if misfit < FITS_WELL and lowest else UNSEEN):
            speed = abs(math.log(firings / sensor.azimuth_steps)) if firings else 0.0
            costs.append((round(misfit + 0.5 * unseen + 0.02 * speed, 2), sensor.name))
    return min(costs, key=lambda cost: cost[0])


def _misfit(angles: NDArray[np.float64], beams: NDArray[np.float64]) -> tuple[float, float]:
    """How badly the beams of a sensor explain those that are seen, and the share of them that is not.

    The n-th that is seen is the n-th of the sensor, but for those above it that have no return.
    """
    count = len(beams)
    gaps = -np.diff(beams)
    inside = (angles <= beams[0]) & (angles >= beams[-1])
    beyond = np.mean((angles > beams[0] + gaps[0] / 2 + 1) | (angles < beams[-1] - gaps[-1] / 2 - 1))
    if np.count_nonzero(inside) < 3:
        return math.inf, 1.0
    ahead = np.interp(-angles[inside], -beams, np.arange(count)) - np.flatnonzero(inside)
    away = np.abs(ahead - np.median(ahead)) / count
    off = np.mean(away) + 0.3 * np.quantile(away, 0.95)
    unseen, more = max(0, count - len(angles)) / count, max(0, len(angles) - count) / count
    ends = abs(angles[0] - beams[0]) + abs(angles[-1] - beams[-1]) if unseen < 0.1 else 0.0
    return float(off + beyond + more + 0.5 * ends / (beams[0] - beams[-1])), unseen


def _unlike(angles: NDArray[np.float64], sensor: Sensor) -> float:
    """How far a sensor is from what is seen, in beams and field of view."""
    ends = abs(angles[-1] - sensor.elevations[-1]) + abs(angles[0] - sensor.elevations[0])
    return abs(math.log(len(angles) / sensor.beams)) + float(ends) / 30


def _at_speed(sensor: Sensor, firings: float) -> Sensor:
    """The sensor with as many firings in a turn as were seen: at one of its speeds, if that is nearly so."""
    if not firings:
        return sensor
    off = {speed: abs(math.log(sensor.azimuth_steps / speed / firings)) for speed in SPEEDS}
    speed = min(SPEEDS, key=lambda one: off[one])
    if off[speed] > NEARLY:
        return replace(sensor, azimuth_steps=round(firings))
    return sensor if speed == 1.0 else sensor.spinning(speed)


def _falling(angles: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(sorted({round(float(angle), 2) for angle in angles}, reverse=True))


def _said(mounting: Pose) -> str:
    tilt = math.degrees(math.acos(min(1.0, float(mounting[2, 2]))))
    away = float(np.linalg.norm(mounting[:3, 3]))
    words = [f"tilted by {tilt:.0f} degrees"] * (tilt >= 0.5) + [f"{away:.1f} m away"] * (away > 0)
    return f"the scan's frame is not the sensor's but {' and '.join(words)}, which is undone"

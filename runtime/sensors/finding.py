"""Which sensor measured a scan: by its beams, its field of view and the firings in its turn.

Within a narrow sector of azimuth a beam leaves points of nearly one elevation, whatever the scene: how many such groups
there are tells the number of beams, where they lie all around their angles.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.sensors.registry import SENSORS
from runtime.sensors.sensor import Sensor

FEWEST = 400  # points that tell anything
NEAR = 3.0  # m, within which the carrier's motion and the beams' own places blur angles
SECTORS = 719  # of half a degree; odd, so that their edges do not fall on the columns of a sensor
LOOKED_AT = 3  # every so-manieth of them
BEAM_GAP = 0.08  # degrees between the groups of neighbouring beams, at least
BIN = 0.05  # degrees, in which elevations are counted to find the angles of beams
FITS = 0.4  # mean distance from a sensor's beams, where 1 is that of points anywhere between them
OUTSIDE = 0.02  # share of the points beyond a sensor's field of view, at most
BLURRED = 0.06  # the same for a sensor whose beams do not leave from one point
TURN = 300.0  # degrees of azimuth with points, at least, where a sensor turns
USUAL = (16, 20, 24, 32, 40, 48, 64, 80, 96, 128)  # beams
SOME = 8000  # points that are compared with the beams of every sensor


@dataclass(frozen=True)
class Found:
    """The sensor of a scan."""

    sensor: Sensor
    nearest: str  # name of the known sensor that it is most like
    text: str  # what was seen, and what it was taken for


@dataclass(frozen=True)
class Seen:
    """What a scan shows of its sensor; degrees."""

    elevation: NDArray[np.float64]  # (M,) of the points beyond NEAR
    azimuth: NDArray[np.float64]  # (M,)
    beams: int
    view: tuple[float, float]  # lowest and highest beam
    angles: tuple[float, ...]  # of the beams from the top down
    turn: float  # of azimuth with points


def find_from_scan(scan: ArrayLike) -> Found | None:
    """The sensor of a scan (N, >=3), x, y, z in m, in the sensor's own frame; None where too few points tell."""
    seen = look(np.asarray(scan))
    if seen is None:
        return None
    low, high = seen.view
    text = f"about {seen.beams} beams, {low:.0f} to {high:.0f} degrees: "
    misfits = {name: misfit(seen, sensor) for name, sensor in SENSORS.items()}
    best = min(misfits, key=lambda name: misfits[name])
    if misfits[best] < 1:
        sensor, nearest = with_firings(SENSORS[best], seen), best
        text += f"as {best}"
    else:
        nearest = min(SENSORS, key=lambda name: unlike(seen, SENSORS[name]))
        sensor = with_firings(Sensor("found", completed(seen.angles, SENSORS[nearest]), 1800, max_range=100.0), seen)
        text += f"much like {nearest}, in rows for the beams that are there"
    if seen.turn < TURN:
        text += f"; a view {seen.turn:.0f} degrees wide, where networks expect a full turn"
    return Found(sensor, nearest, text)


def look(scan: NDArray[np.floating]) -> Seen | None:
    """What a scan shows of its sensor; None where too few points tell."""
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = (scan[:, axis].astype(np.float64) for axis in range(3))
        flat = np.hypot(x, y)
        away = (flat > NEAR) & (flat < 1e4) & np.isfinite(z)
    if np.count_nonzero(away) < FEWEST:
        return None
    elevation, azimuth = np.degrees(np.arctan2(z[away], flat[away])), np.degrees(np.arctan2(y[away], x[away]))
    sector = ((azimuth / 360 + 0.5) * SECTORS).astype(np.int64)
    some = sector % LOOKED_AT == 0
    order = np.lexsort((elevation[some], sector[some]))
    rising, its = elevation[some][order], sector[some][order]
    first = np.concatenate([[True], (np.diff(its) > 0) | (np.diff(rising) > BEAM_GAP)])
    counts = np.bincount(its[first])
    counts = counts[counts > 0]
    beams = max(2, usual(round(float(np.percentile(counts, 90)))))
    low, high = np.quantile(elevation, (0.001, 0.999)).tolist()
    group = np.cumsum(first) - 1
    middles = np.bincount(group, rising) / np.bincount(group)  # of each group
    turn = float(np.count_nonzero(np.bincount(sector)) * 360 / SECTORS)
    return Seen(elevation, azimuth, beams, (low, high), angles_of(middles, beams), turn)


def usual(beams: int) -> int:
    """The number of beams of some sensor, if that is about as many."""
    nearest = min(USUAL, key=lambda one: abs(one - beams))
    return nearest if abs(nearest - beams) <= 0.15 * nearest else beams


def angles_of(middles: NDArray[np.float64], beams: int) -> tuple[float, ...]:
    """Degrees at which groups of points gather, from the top down; where they do not, as dense as the groups lie."""
    low = math.floor(middles.min()) - 1
    counts = np.bincount(((middles - low) / BIN).astype(np.int64), minlength=8)
    smooth = np.convolve(counts, (0.25, 0.5, 0.25), "same")
    left, right = np.roll(smooth, 1), np.roll(smooth, -1)
    peaks = np.flatnonzero((smooth > left) & (smooth >= right) & (smooth > 0.2 * np.sort(smooth)[-beams:].mean()))
    if 0.85 * beams <= len(peaks) <= 1.1 * beams:
        centres = low + (peaks + 0.5) * BIN
        found = [float(np.median(middles[np.abs(middles - at) < 1.5 * BIN])) for at in centres]
    else:
        found = np.quantile(middles, (np.arange(beams) + 0.5) / beams).tolist()
    return tuple(sorted({round(angle, 2) for angle in found}, reverse=True))


def completed(angles: tuple[float, ...], like: Sensor) -> tuple[float, ...]:
    """The angles of beams, with those of a sensor with more of them above and below: such as now see but sky."""
    missing = max(0, like.beams - len(angles))
    gap = 1.5 * (angles[0] - angles[-1]) / max(1, len(angles) - 1)
    above = [angle for angle in like.elevations if angle > angles[0] + gap][-missing:] if missing else []
    below = [angle for angle in like.elevations if angle < angles[-1] - gap][: missing - len(above)]
    return (*above, *angles, *below)


def misfit(seen: Seen, sensor: Sensor) -> float:
    """How badly a sensor explains what is seen: below 1 where it may be the one."""
    elevation = seen.elevation[:: max(1, len(seen.elevation) // SOME)]
    beams = np.array(sensor.elevations)[::-1]
    gaps = np.diff(beams)
    low, high = float(beams[0] - gaps[0]), float(beams[-1] + gaps[-1])
    outside = float(np.mean((elevation < low) | (elevation > high)))
    above = np.searchsorted(beams, elevation).clip(1, len(beams) - 1)
    away = np.minimum(np.abs(elevation - beams[above]), np.abs(elevation - beams[above - 1]))
    off = float(np.mean(4 * away / gaps[above - 1]))  # 0 on the beams, 1 anywhere
    reached = (min(seen.view[1], high) - max(seen.view[0], low)) / (high - low)  # upper beams may see but sky
    fewer = abs(seen.beams / (sensor.beams * max(0.01, min(1.0, reached))) - 1)
    if off < FITS and outside < OUTSIDE and reached > 0.4 and fewer < 0.3:
        return off + 0.3 * (1 - reached)
    if len(sensor.lifts) > 1 and outside < BLURRED and fewer < 0.15 and reached > 0.85:
        return 0.8  # its beams do not leave from one point
    return 1.0 + outside


def unlike(seen: Seen, sensor: Sensor) -> float:
    """How far a sensor is from what is seen, in beams and field of view."""
    ends = abs(seen.view[0] - sensor.elevations[-1]) + abs(seen.view[1] - sensor.elevations[0])
    return abs(math.log(seen.beams / sensor.beams)) + ends / 30


def with_firings(sensor: Sensor, seen: Seen) -> Sensor:
    """The sensor at the speed at which it turned: as many firings as the points of its beams are apart."""
    beams = np.array(sensor.elevations)[::-1]
    rows = np.searchsorted(0.5 * (beams[1:] + beams[:-1]), seen.elevation)
    steps = []
    for row in np.argsort(np.bincount(rows))[-8:]:  # those with the most points
        gaps = np.diff(np.sort(seen.azimuth[rows == row]))
        gaps = gaps[(gaps > 0.02) & (gaps < 2)]
        if len(gaps) > 50:
            steps.append(float(np.median(gaps)))
    if not steps:
        return sensor
    firings = round(360 / float(np.median(steps)))
    if sensor.name not in SENSORS:
        return replace(sensor, azimuth_steps=firings)
    speeds = (0.5, 1.0, 2.0)  # half the rate has twice the firings
    speed = min(speeds, key=lambda one: abs(math.log(sensor.azimuth_steps / one / firings)))
    return sensor if speed == 1.0 else sensor.spinning(speed)

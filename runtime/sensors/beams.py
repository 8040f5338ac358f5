"""The beams that a scan shows. Whatever the scene, in a narrow column of azimuth the points of a beam have nearly one
elevation: how many groups of points a column has tells the number of beams, where they lie all around their angles.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.errors import ScanError
from runtime.sensors.sensor import FARTHEST

Values = NDArray[np.float64]

FEWEST = 400  # points that tell anything
NEAREST = 1.0  # m, of points that are looked at
WIDTHS = 0.5, 1.0  # degrees, of a column; the wide ones where the narrow ones miss beams
FIRED = 1.3  # points that a beam leaves in a column, at least: fewer, and columns miss beams
ENOUGH = 40_000  # points that are looked at, in some of the columns
SPLIT = 0.05  # degrees between groups, before it is known how far beams are apart
APART = 0.45  # of that distance: what lies nearer is one beam
REGULAR = 0.7, 1.4  # times the usual distance: of beams that are neighbours
FULL = 0.9  # quantile of the groups in a column that is the number of beams: many columns miss those that see the sky
USUAL = (16, 32, 40, 64, 80, 128)  # beams
LEAST, MOST = 4, 256  # beams that a sensor may have
FEW = 5  # groups of a beam, at least
GATHER = 0.15  # of the distance between beams: groups of one beam lie as near to each other, if beams are level
SHARP = 0.9  # share of the groups that then do, at least
SEVERAL = 5  # columns with as many groups as beams


@dataclass(frozen=True)
class Groups:
    """Points of one beam in one column, column after column, in each from the top down."""

    column: NDArray[np.int64]  # (G,)
    azimuth: Values  # (G,) degrees, of the column
    elevation: Values  # (G,) degrees
    nearness: Values  # (G,) 1 / m


@dataclass(frozen=True)
class Beams:
    """What a scan shows of its sensor; degrees."""

    angles: Values  # (B,) elevations of the beams, from the top down: of columns that have them all
    level: Values | None  # (B',) the same by where groups gather all around, which beams that hardly return do too
    firings: float  # in a full turn
    regular: float  # share of the groups whose neighbour is as far as beams are
    turn: float  # of azimuth with points
    groups: Groups  # those of columns that have all beams
    beam: NDArray[np.int64]  # (G,) of each group, from the top down


def look(points: NDArray[np.floating], ring: ArrayLike | None = None) -> Beams | None:
    """The beams of a scan (N, >=3) in m; ring: (N,) number of the laser of each point.

    None where too few points tell. Raises ScanError for rings of other points.
    """
    if ring is not None and np.shape(ring) != (len(points),):
        raise ScanError(f"ring must hold the laser of each of {len(points)} points, not {np.shape(ring)}")
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = (points[:, axis].astype(np.float32) for axis in range(3))
        flat = np.hypot(x, y)
        distance = np.hypot(flat, z)
        usable = (distance > NEAREST) & (distance < FARTHEST)
    if np.count_nonzero(usable) < FEWEST:
        return None
    elevation = np.degrees(np.arctan2(z[usable], flat[usable])).astype(np.float64)
    azimuth = np.degrees(np.arctan2(y[usable], x[usable])).astype(np.float64)
    nearness = 1 / distance[usable].astype(np.float64)
    turn = float(np.count_nonzero(np.bincount(((azimuth + 180) % 360).astype(np.int64))))
    if ring is not None and (told := _by_ring(azimuth, elevation, nearness, np.asarray(ring)[usable], turn)):
        return told
    for width in WIDTHS:
        measured = _Sorted.of(azimuth, elevation, nearness, width)
        starts = measured.starts(lambda between: np.full(len(between), SPLIT))
        if len(measured.elevation) / len(starts) > FIRED:
            break
    distance_of = _distances(measured.groups(starts))
    starts = measured.starts(lambda between: APART * distance_of(between))
    groups = measured.groups(starts)
    angles, kept, beam = _angles(groups)
    if len(angles) < LEAST or angles[0] - angles[-1] < 1:
        return None
    regular, level = _regular(groups, distance_of), _level(groups, distance_of)
    return Beams(angles, level, measured.firings(starts), regular, turn, kept, beam)


def _by_ring(
    azimuth: Values, elevation: Values, nearness: Values, ring: NDArray[np.generic], turn: float
) -> Beams | None:
    """The beams by the numbers of their lasers; None where those are of no use, as in clouds of several sensors."""
    _, laser, counts = np.unique(ring, return_inverse=True, return_counts=True)
    if not LEAST <= len(counts) <= MOST:
        return None
    by_laser = np.split(elevation[np.argsort(laser, kind="stable")], np.cumsum(counts)[:-1])
    medians = np.array([np.median(one) for one in by_laser])
    place = np.empty(len(medians), np.int64)  # of each laser, from the top down
    place[np.argsort(-medians)] = np.arange(len(medians))
    for width in WIDTHS:
        measured = _Sorted.of(azimuth, elevation, nearness, width, place[laser])
        starts = measured.starts(None)
        if len(measured.elevation) / len(starts) > FIRED:
            break
    groups, beam = measured.groups(starts), measured.beam[starts]
    angles = np.array([np.median(groups.elevation[beam == one]) for one in range(len(medians))])
    spread = np.maximum.reduceat(measured.elevation, starts) - np.minimum.reduceat(measured.elevation, starts)
    if np.quantile(spread, 0.8) > APART * np.median(-np.diff(angles)):
        return None
    return Beams(angles, None, measured.firings(starts), 1.0, turn, groups, beam)


@dataclass(frozen=True)
class _Sorted:
    """Points column after column, in each from the top down."""

    column: NDArray[np.int64]
    columns: int  # in a full turn
    azimuth: Values
    elevation: Values
    nearness: Values
    beam: NDArray[np.int64]  # where it is known

    @classmethod
    def of(
        cls,
        azimuth: Values,
        elevation: Values,
        nearness: Values,
        width: float,
        beam: NDArray[np.int64] | None = None,
    ) -> "_Sorted":
        columns = round(360 / width) | 1  # odd, so that their edges do not fall on the firings of a sensor
        column = np.minimum((azimuth + 180) / 360 * columns, columns - 1).astype(np.int64)
        some = column % max(1, len(column) // ENOUGH) == 0
        azimuth, elevation, nearness, column = azimuth[some], elevation[some], nearness[some], column[some]
        place = ((90 - elevation) * 5000).astype(np.int64) if beam is None else beam[some]
        order = np.argsort(column * (1 << 20) + place)
        return cls(column[order], columns, azimuth[order], elevation[order], nearness[order], place[order])

    def starts(self, apart: Callable[[Values], Values] | None) -> NDArray[np.int64]:
        """The first point of each group: `apart` degrees below the one before, by the elevation between them.

        None: where the beam is another.
        """
        above, below = self.elevation[:-1], self.elevation[1:]
        other = np.diff(self.beam) != 0 if apart is None else above - below > apart((above + below) / 2)
        first = (np.diff(self.column) > 0) | other
        return np.flatnonzero(np.concatenate([[True], first]))

    def groups(self, starts: NDArray[np.int64]) -> Groups:
        counts = np.diff(np.append(starts, len(self.column)))
        column = self.column[starts]
        azimuth = (column + 0.5) * 360 / self.columns - 180
        means = (np.add.reduceat(values, starts) / counts for values in (self.elevation, self.nearness))
        return Groups(column, azimuth, *means)

    def firings(self, starts: NDArray[np.int64]) -> float:
        """In a full turn, by the steps of azimuth within groups."""
        group = np.zeros(len(self.column), np.int64)
        group[starts[1:]] = 1
        group = group.cumsum()
        order = np.argsort(group * (1 << 24) + ((self.azimuth + 180) * 40_000).astype(np.int64))
        steps = np.diff(self.azimuth[order])[np.diff(group[order]) == 0]
        steps = steps[steps > 0.03]  # the rest are second returns
        return 360 / float(np.median(steps)) if len(steps) else 0.0


def _distances(groups: Groups) -> Callable[[Values], Values]:
    """How far beams are apart at an elevation: the least of the medians in its band of a degree and the two beside."""
    apart, between = _neighbours(groups)
    band = (between + 90).astype(np.int64).clip(0, 180)
    order = np.lexsort((apart, band))
    bands, first, counts = np.unique(band[order], return_index=True, return_counts=True)
    many = counts > 20
    if not many.any():
        return lambda elevations: np.full(len(elevations), 2 * SPLIT)
    medians = np.full(183, np.inf)
    medians[bands[many] + 1] = apart[order][first + counts // 2][many]
    least = np.minimum(np.minimum(medians[:-2], medians[1:-1]), medians[2:])
    known = np.flatnonzero(np.isfinite(least))
    least = least[known[np.abs(np.arange(181)[:, None] - known).argmin(1)]]  # of the nearest band that is known
    return lambda elevations: least[(elevations + 90).astype(np.int64).clip(0, 180)]


def _neighbours(groups: Groups) -> tuple[Values, Values]:
    """Degrees from each group to the one below it in its column, and the elevation between them."""
    below = np.diff(groups.column) == 0
    above, under = groups.elevation[:-1][below], groups.elevation[1:][below]
    return above - under, (above + under) / 2


def _regular(groups: Groups, distance_of: Callable[[Values], Values]) -> float:
    apart, between = _neighbours(groups)
    times = apart / distance_of(between)
    return float(np.mean((times > REGULAR[0]) & (times < REGULAR[1]))) if len(times) else 0.0


def _angles(groups: Groups) -> tuple[Values, Groups, NDArray[np.int64]]:
    """Elevations of the beams, the groups of columns that have all of them, and the beam of each of those."""
    counts = np.bincount(groups.column)
    there = counts[counts > 0]
    beams = usual(round(float(np.quantile(there, FULL))))
    often = np.bincount(there)
    number = min(np.flatnonzero(often >= min(SEVERAL, often.max())), key=lambda one: abs(int(one) - beams))
    full = counts[groups.column] == number
    kept = Groups(groups.column[full], groups.azimuth[full], groups.elevation[full], groups.nearness[full])
    beam = np.tile(np.arange(number), len(kept.column) // int(number))
    return np.median(kept.elevation.reshape(-1, number), axis=0), kept, beam


def _level(groups: Groups, distance_of: Callable[[Values], Values]) -> Values | None:
    """Elevations at which groups gather all around, from the top down; None where they do not, as in a tilted frame."""
    rising = np.sort(groups.elevation)
    apart = distance_of(rising)
    near = np.searchsorted(rising, rising + GATHER * apart) - np.searchsorted(rising, rising - GATHER * apart)
    peaks: list[int] = []
    while near[at := int(near.argmax())] >= FEW:
        peaks.append(at)
        low, high = np.searchsorted(rising, (rising[at] - 0.6 * apart[at], rising[at] + 0.6 * apart[at]))
        near[low:high] = 0
    if len(peaks) < LEAST:
        return None
    centres = np.sort(rising[peaks])
    edges = np.searchsorted(rising, (centres[1:] + centres[:-1]) / 2)
    middles = np.array([np.median(part) for part in np.split(rising, edges)])
    beam = np.repeat(np.arange(len(middles)), np.diff([0, *edges, len(rising)]))
    gathered = np.mean(np.abs(rising - middles[beam]) < GATHER * apart)
    return middles[::-1] if gathered > SHARP else None


def usual(beams: int) -> int:
    """The number of beams of some sensor, if that is about as many."""
    nearest = min(USUAL, key=lambda one: abs(one - beams))
    return nearest if abs(nearest - beams) <= 0.1 * nearest else beams

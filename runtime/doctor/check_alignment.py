"""Do the poses of a recording fit its scans? If not, what may they be instead?"""

import math
from collections.abc import Sequence
from statistics import median

import numpy as np

from runtime.doctor.alignment import SUSPECT, Fit, check_fits, difference, fit, metres, scans
from runtime.doctor.findings import Finding
from runtime.doctor.pairs import Pair, read_pairs
from runtime.errors import some
from runtime.recordings.poses import Poses
from runtime.recordings.recording import Indexed
from runtime.sensors.range_image import RangeImage

READINGS = {  # what to do where the poses of a recording fit better if they are meant otherwise
    "lidar": "they are taken as poses of the LiDAR: use `frame='lidar'`",
    "camera": "they are taken as poses of KITTI's camera: use `frame='camera'` with its calib.txt",
    "inverse": "they are inverted: the file seems to hold T_lidar_world",
}
SHIFT = 3  # scans by which poses are tried earlier and later
FITS = 0.3  # m, misfit of poses that are good, and of many that are not
STANDS, MOVES = 0.3, 1.0  # m, motion of a point 10 m away that is none, and that shows poses out of step
BETTER = 0.93  # poses out of step must lower the misfit to this share, and by this much in m, to be believed
CLEARER = 0.005
MUCH_BETTER = 0.7  # share for another meaning of all the poses


def check_alignment(recording: Indexed, poses: Poses, geometry: RangeImage) -> Finding:
    """Static surroundings under poses T_world_lidar (len(recording), 4, 4), against the best motions, other meanings of
    the poses, and poses out of step.

    geometry: range image in which scans are compared. Scans that cannot be read, or show little, are left out.
    """
    if len(recording) < 2:
        return Finding("warn", "alignment", "two scans are needed to see whether the poses fit")
    pairs = read_pairs(recording, geometry, margin=SHIFT)
    fits = [fit(pair.view, pair.landmarks, pair.motion(poses), pair.lag) for pair in pairs]
    clear = [(pair, one) for pair, one in zip(pairs, fits, strict=True) if not math.isnan(one.given)]
    if not clear:
        return Finding("warn", "alignment", "too few walls, trunks or cars in sight to see whether the poses fit")
    lag = max(pair.lag for pair, _ in clear)
    chosen = [pair for pair, _ in clear if pair.lag == lag]
    given = _misfit(chosen, poses)
    apart = f"static surroundings {scans(lag)} later lie {metres(given)} off"
    for meaning, others in recording.other_poses().items():
        if given > SUSPECT[lag] and (other := _misfit(chosen, others)) < MUCH_BETTER * given:
            return Finding("bad", "alignment", f"{apart}, but only {metres(other)} if {READINGS[meaning]}")
    if bad := check_fits(fits):
        return _check_step(chosen, poses, apart, MUCH_BETTER) or bad
    moved = [difference(pair.motion(poses), np.eye(4)) for pair in chosen]
    if max(moved) < STANDS:
        return Finding("ok", "alignment", f"{apart}; nothing moves, so that a wrong frame or step would not show")
    step = _check_step(chosen, poses, apart, BETTER) if median(moved) > MOVES else None
    return step or _check_outliers(clear, apart)


def _check_step(pairs: Sequence[Pair], poses: Poses, apart: str, better: float) -> Finding | None:
    """Bad if poses some lines earlier or later lower the misfit to a share of `better`."""
    inner = [pair for pair in pairs if pair.earlier >= SHIFT and pair.later + SHIFT < len(poses)]
    given = _misfit(inner, poses)
    shifted = {shift: _misfit(inner, poses, shift) for shift in range(-SHIFT, SHIFT + 1) if shift}
    best = min(shifted, key=lambda shift: shifted[shift])
    if not shifted[best] < min(better * given, given - CLEARER):
        return None
    line = f"{abs(best)} line{'s' if abs(best) > 1 else ''} {'later' if best > 0 else 'earlier'}"
    text = f"{apart}, but only {metres(shifted[best])} if each scan takes the pose {line}: out of step"
    return Finding("bad", "alignment", text)


def _check_outliers(fits: Sequence[tuple[Pair, Fit]], apart: str) -> Finding:
    """A warning if single pairs of scans, or all of them, lie far off."""
    usual = median(one.given for _, one in fits)
    lost = [f"{pair.earlier} to {pair.later}" for pair, one in fits if one.given > max(FITS, 3 * usual)]
    if usual > FITS:
        return Finding("warn", "alignment", f"{apart}: much moves here, or the poses are poor")
    if lost:
        return Finding("warn", "alignment", f"{apart}, but far more from {some(lost)}: are these poses right?")
    return Finding("ok", "alignment", f"{apart}: poses and scans fit")


def _misfit(pairs: Sequence[Pair], poses: Poses, shift: int = 0) -> float:
    """Median in m of those pairs that show anything; infinite if none does."""
    values = [pair.view.misfit(pair.landmarks, pair.motion(poses, shift)) for pair in pairs]
    return median([value for value in values if not math.isnan(value)] or [math.inf])

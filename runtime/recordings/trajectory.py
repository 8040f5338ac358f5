"""Poses of another rate than the scans: which one a scan has at its time."""

import warnings

import numpy as np
import numpy.typing as npt

from runtime.errors import MosWarning, some
from runtime.recordings.poses import FARTHEST, Poses
from runtime.recordings.rotations import matrices_of_turns, turns_of_matrices

SAME = 1e-5  # s; a pose so near in time is taken as it is
LONGEST_GAP = 0.5  # s between two poses, over which a vehicle may turn in ways that a line does not follow
BEYOND = 0.1  # s before the first pose or after the last, over which a motion goes on as it is


def poses_at(
    times: npt.NDArray[np.float64],
    known: npt.NDArray[np.float64],
    poses: Poses,
    source: str,
    longest_gap: float = LONGEST_GAP,
) -> tuple[Poses, dict[int, str]]:
    """Poses (T, 4, 4) at `times` (T,) s, between `poses` (K, 4, 4) at the times `known` (K,) s, in any order.

    Positions lie on a line, rotations on the shortest turn. Also which of them are not known, and why, beginning with
    `source`: they are NaN. Before the first pose, or after the last, the motion goes on as it is for the time from one
    pose to the next, but `BEYOND` at most, with a MosWarning; none is ever taken from farther away.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        usable = np.isfinite(known) & (abs(poses) <= FARTHEST).all((1, 2)) & (np.linalg.det(poses[:, :3, :3]) > 0)
    known, order = np.unique(known[usable], return_index=True)
    poses = poses[usable][order]
    if not len(known):
        return np.full((len(times), 4, 4), np.nan), dict.fromkeys(
            range(len(times)), f"{source}: has no pose that can be used"
        )
    after = np.searchsorted(known, times)
    low = np.clip(after - 1, 0, max(0, len(known) - 2))
    high = np.minimum(low + 1, len(known) - 1)
    nearest = np.where(abs(known[low] - times) <= abs(known[high] - times), low, high)
    found = _between(poses[low], poses[high], (times - known[low]) / np.maximum(known[high] - known[low], SAME))
    same = abs(known[nearest] - times) <= SAME
    found[same] = poses[nearest[same]]

    outside = ~same & ((after == 0) | (after == len(known)))
    reach = min(BEYOND, float(np.median(np.diff(known)))) + SAME if len(known) > 1 else 0.0
    near = outside & (abs(known[nearest] - times) <= reach)
    apart = ~same & ~outside & (known[high] - known[low] > longest_gap)
    why: dict[int, str] = {}
    span = f"they go from {known[0]:.3f} to {known[-1]:.3f} s"
    for index in map(int, np.flatnonzero((outside & ~near) | apart)):
        place, beside = "at", span
        if apart[index]:
            place, beside = "near", f"none is known from {known[low[index]]:.3f} to {known[high[index]]:.3f} s"
        why[index] = f"{source}: has no pose {place} {times[index]:.3f} s, the time of the scan; {beside}"
    found[list(why)] = np.nan
    if near.any():
        scans = some([f"{index} ({times[index]:.3f} s)" for index in map(int, np.flatnonzero(near))])
        warnings.warn(f"{source}: {span}, and the motion goes on as it is for scan {scans}", MosWarning, stacklevel=2)
    return found, why


def _between(before: Poses, after: Poses, share: npt.NDArray[np.float64]) -> Poses:
    """Poses (T, 4, 4), `share` (T,) of the way from the ones to the others."""
    poses = np.tile(np.eye(4), (len(share), 1, 1))
    first = before[:, :3, :3]
    turn = turns_of_matrices(first.transpose(0, 2, 1) @ after[:, :3, :3])
    poses[:, :3, :3] = first @ matrices_of_turns(share[:, None] * turn)
    poses[:, :3, 3] = (1 - share[:, None]) * before[:, :3, 3] + share[:, None] * after[:, :3, 3]
    return poses

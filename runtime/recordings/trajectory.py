"""Poses of another rate than the scans: which one a scan has at its time."""

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from runtime.recordings.poses import Poses

SAME = 1e-5  # s; a pose so near in time is taken as it is
LONGEST_GAP = 0.5  # s between two poses, over which a vehicle may turn in ways that a line does not follow


def poses_at(
    times: npt.NDArray[np.float64], known: npt.NDArray[np.float64], poses: Poses, source: str
) -> tuple[Poses, dict[int, str]]:
    """Poses (T, 4, 4) at `times` (T,) s, between `poses` (K, 4, 4) at the times `known` (K,) s, in any order.

    Positions lie on a line, rotations on the shortest turn. Also which of them are not known, and why, beginning with
    `source`: they are NaN. None is ever taken from before or after all that is known.
    """
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(known) & np.isfinite(poses).all((1, 2)) & (np.linalg.det(poses[:, :3, :3]) > 0)
    known, order = np.unique(known[usable], return_index=True)
    poses = poses[usable][order]
    found = np.full((len(times), 4, 4), np.nan)
    why: dict[int, str] = {}
    for index, time in enumerate(times):
        after = int(np.searchsorted(known, time))
        beside = [i for i in (after - 1, after) if 0 <= i < len(known)]
        nearest = min(beside, key=lambda i: abs(known[i] - time), default=None)
        if nearest is not None and abs(known[nearest] - time) <= SAME:
            found[index] = poses[nearest]
        elif len(beside) < 2:
            span = f"they go from {known[0]:.3f} to {known[-1]:.3f} s" if len(known) else "there is none"
            why[index] = f"{source}: has no pose at {time:.3f} s, the time of the scan; {span}"
        elif known[after] - known[after - 1] > LONGEST_GAP:
            gap = f"{known[after - 1]:.3f} to {known[after]:.3f} s"
            why[index] = f"{source}: has no pose near {time:.3f} s, the time of the scan; none is known from {gap}"
        else:
            found[index] = _between(poses[beside], float((time - known[after - 1]) / (known[after] - known[after - 1])))
    return found, why


def _between(two: Poses, share: float) -> npt.NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3] = Slerp([0, 1], Rotation.from_matrix(two[:, :3, :3]))(share).as_matrix()
    pose[:3, 3] = (1 - share) * two[0, :3, 3] + share * two[1, :3, 3]
    return pose

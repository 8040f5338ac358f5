"""Points that were measured one after the other while the LiDAR moved, brought to one time."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from runtime.compute.jit import kernel
from runtime.recordings.poses import Pose, relative_pose
from runtime.recordings.rotations import matrices_of_turns, turns_of_matrices
from runtime.recordings.scans import ScanData
from runtime.recordings.trajectory import LONGEST_GAP

Velocity = npt.NDArray[np.float64]  # (6,) rad/s around, and m/s along x, y, z of the LiDAR
Times = npt.NDArray[np.float32]  # (N,) s after the time of the scan
FASTEST = 100.0  # m/s; between poses farther apart there is a jump, and no motion
ENDS = (0.01, 0.99)  # quantiles of the times of points, between which the sweep is: some are wild


@dataclass(frozen=True)
class Motion:
    """How the LiDAR moves while it turns: on a line, and on the shortest turn, as `poses_at` has it between poses."""

    before: Velocity  # until the time of the scan
    after: Velocity  # from then on

    def at(self, time: float) -> Pose:
        """(4, 4) T_lidar_then: where the LiDAR is `time` s after the time of the scan, in its frame of that time."""
        velocity = self.before if time < 0 else self.after
        pose = np.eye(4)
        pose[:3, :3] = matrices_of_turns(velocity[:3] * time)
        pose[:3, 3] = velocity[3:] * time
        return pose

    def back_from(self, time: float) -> Pose:
        """(4, 4) T_then_lidar, the inverse of `at`."""
        back: Pose = np.linalg.inv(self.at(time)).astype(np.float64)
        return back


STILL = Motion(np.zeros(6), np.zeros(6))


def velocity_to(pose: Pose, other: Pose, seconds: float) -> Velocity:
    """The velocity that takes T_world_lidar `pose` to `other` in `seconds`, which are negative for a pose before."""
    step = relative_pose(pose, other)
    return np.concatenate([turns_of_matrices(step[:3, :3]), step[:3, 3]]) / seconds


def velocity_between(pose: Pose, other: Pose, seconds: float) -> Velocity | None:
    """As `velocity_to`; None where the poses are too far apart, in time or otherwise, to tell how the LiDAR moved."""
    if not 0 < abs(seconds) <= LONGEST_GAP:
        return None
    velocity = velocity_to(pose, other, seconds)
    return velocity if np.linalg.norm(velocity[3:]) <= FASTEST else None


def steady(velocity: Velocity | None) -> Motion:
    """At one velocity; none where that is not known."""
    return STILL if velocity is None else Motion(velocity, velocity)


def middle_of(times: Times) -> float:
    """The middle of a sweep in s, of the times of its points, to a millisecond: the same for all sweeps alike."""
    return round(float(np.quantile(times, ENDS).mean()), 3)


def span_of(times: Times) -> float:
    """How long a sweep takes in s, of the times of its points, to a millisecond."""
    return round(float(np.ptp(np.quantile(times, ENDS))), 3)


def deskewed(data: ScanData, times: Times, motion: Motion, reference: float = 0.0) -> ScanData:
    """A scan (N, 3 or 4) f32 with all points where they are seen from the LiDAR at `reference`, s after its time.

    times: (N,) s. Points keep their order, and remission; those that are not finite, or at the origin, stay so.
    """
    moved = data.copy()
    _move(data, times, motion.before, motion.after, motion.back_from(reference), moved)
    return moved


@kernel
def _move(data, times, before, after, back, moved):  # type: ignore[no-untyped-def]
    """Rodrigues' formula for each point, then `back` (4, 4), into `moved`."""
    for i in range(data.shape[0]):
        t = np.float64(times[i])
        v = before if t < 0 else after
        speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        over = 1 / speed if speed > 0 else 0.0
        a, b, c = v[0] * over, v[1] * over, v[2] * over  # axis
        sine, cosine = np.sin(speed * t), np.cos(speed * t)
        x, y, z = np.float64(data[i, 0]), np.float64(data[i, 1]), np.float64(data[i, 2])
        if x == 0 and y == 0 and z == 0:  # no return, which it must stay
            continue
        along = (a * x + b * y + c * z) * (1 - cosine)
        px = cosine * x + sine * (b * z - c * y) + along * a + v[3] * t
        py = cosine * y + sine * (c * x - a * z) + along * b + v[4] * t
        pz = cosine * z + sine * (a * y - b * x) + along * c + v[5] * t
        for k in range(3):
            moved[i, k] = back[k, 0] * px + back[k, 1] * py + back[k, 2] * pz + back[k, 3]

"""Are poses rigid, whole, in the right frame and in step with their scans?"""

import contextlib

import numpy as np
import numpy.typing as npt

from runtime.doctor.alignment import REACH, Landmarks, choose_pairs, misfits
from runtime.doctor.findings import Finding
from runtime.errors import MosError, PoseError, some
from runtime.recordings.poses import Pose, Poses, check_pose
from runtime.recordings.recording import Indexed

READINGS = {  # what to do where the poses of a recording fit better if they are meant otherwise
    "lidar": "they are taken as poses of the LiDAR: use `frame='lidar'`",
    "camera": "they are taken as poses of KITTI's camera: use `frame='camera'` with its calib.txt",
    "inverse": "they are inverted: the file seems to hold T_lidar_world",
}
PERIOD = 0.1  # s between scans of SemanticKITTI, and of the simulated streets
SHIFT = 3  # scans by which poses are tried earlier and later
FITS = 0.3  # m, median distance between static surroundings that fall together
STANDS = 0.3  # m, motion of a point 10 m away that is none
BETTER = 0.93  # poses out of step must lower the misfit to this share to be believed
MUCH_BETTER = 0.7  # the same for another meaning of all the poses


def check_rigid(poses: Poses) -> list[Finding]:
    """Every pose finite and rigid."""
    broken = []
    for i, pose in enumerate(poses):
        try:
            check_pose(pose, f"pose {i}")
        except PoseError as error:
            broken.append(str(error))
    if broken:
        rest = f" (and {len(broken) - 1} more poses)" if len(broken) > 1 else ""
        return [Finding("bad", "poses", f"{broken[0]}{rest}")]
    return [Finding("ok", "poses", f"{len(poses)} poses, all finite and rigid")]


def check_steps(poses: Poses) -> list[Finding]:
    """Jumps between consecutive poses (T, 4, 4): steps much longer or more turning than both beside them."""
    if len(poses) < 2:
        return []
    relative = np.linalg.inv(poses[:-1]) @ poses[1:]
    length = np.linalg.norm(relative[:, :3, 3], axis=1)
    cosine = (np.trace(relative[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    jumps = [
        f"{i} to {i + 1} ({length[i]:.1f} m, {angle[i]:.0f} degrees)"
        for i in range(len(relative))
        if length[i] > 1.5 * _beside(length, i) + 0.2 or angle[i] > 1.5 * _beside(angle, i) + 5
    ]
    usual = f"{np.median(length):.2f} m and {np.median(angle):.1f} degrees a scan"
    if jumps:
        return [Finding("warn", "motion", f"poses jump from {some(jumps)}, usual are {usual}: scans missing?")]
    return [Finding("ok", "motion", f"steady, {usual}")]


def _beside(values: np.ndarray, i: int) -> float:
    return float(max(values[max(i - 1, 0) : i].max(initial=0), values[i + 1 : i + 2].max(initial=0)))


def check_times(times: npt.NDArray[np.float64]) -> list[Finding]:
    """Rate and gaps of the times (T,) in s."""
    steps = np.diff(times)
    if len(steps) == 0:
        return []
    usual = float(np.median(steps))
    gaps = [f"{i} to {i + 1} ({step:.2f} s)" for i, step in enumerate(steps) if not 0.5 * usual < step < 1.5 * usual]
    if gaps:
        return [Finding("warn", "times", f"time jumps from {some(gaps)}, usual are {usual:.2f} s: scans missing?")]
    if not 0.75 * PERIOD < usual < 1.5 * PERIOD:
        text = f"{usual:.3g} s a scan, no gap; networks are trained at {PERIOD:g} s, and see motion that much weaker or"
        return [Finding("warn", "times", f"{text} stronger: thin the scans out, or train at your rate")]
    return [Finding("ok", "times", f"{usual:.2f} s a scan, no gap")]


def check_alignment(recording: Indexed, poses: Poses) -> list[Finding]:
    """Static surroundings under these poses against no poses, other meanings of them, and poses out of step.

    poses: T_world_lidar, (len(recording), 4, 4).
    """
    pairs = choose_pairs(len(recording), SHIFT) or choose_pairs(len(recording), 0)
    if not pairs:
        return [Finding("warn", "alignment", "two scans are needed to see whether the poses fit")]
    landmarks = {}
    for i in sorted({i for pair in pairs for i in pair}):
        with contextlib.suppress(MosError):  # check_files has said so
            landmarks[i] = Landmarks.of(recording.read(i).data)
    pairs = [pair for pair in pairs if pair[0] in landmarks and pair[1] in landmarks]
    if not pairs:
        return [Finding("bad", "alignment", "cannot be checked: too few scans can be read")]
    if min(len(thing.points) for thing in landmarks.values()) < 100:
        return [Finding("warn", "alignment", "too few walls, trunks or cars in sight to see whether the poses fit")]

    def fit(trial: Poses, shift: int = 0) -> float:
        return float(np.median(misfits(landmarks, trial, pairs, shift)))

    each = misfits(landmarks, poses, pairs)
    given, still = float(np.median(each)), fit(np.broadcast_to(np.eye(4), poses.shape))
    gap = pairs[0][1] - pairs[0][0]
    apart = f"static surroundings {gap} scan{'s' if gap > 1 else ''} later lie {_length(given)} off"
    moves = max(_motion(np.linalg.inv(poses[a]) @ poses[b]) for a, b in pairs)
    if moves < STANDS and still < FITS:
        return [Finding("ok", "alignment", f"{apart}; nothing moves, so that a wrong frame or step would not show")]
    for meaning, trial in recording.other_poses().items():
        if fit(trial) < MUCH_BETTER * given:
            return [Finding("bad", "alignment", f"{apart}, but only {_length(fit(trial))} if {READINGS[meaning]}")]
    if given > FITS or given > still:
        text = f"{apart}, and {_length(still)} with no poses at all: poses and scans do not belong together"
        return [Finding("bad", "alignment", text)]
    if pairs[0][0] >= SHIFT:
        shifted = {shift: fit(poses, shift) for shift in range(-SHIFT, SHIFT + 1) if shift}
        best = min(shifted, key=lambda shift: shifted[shift])
        if shifted[best] < BETTER * given:
            line = f"{abs(best)} line{'s' if abs(best) > 1 else ''} {'later' if best > 0 else 'earlier'}"
            text = f"{apart}, but only {_length(shifted[best])} if each scan takes the pose {line}: out of step"
            return [Finding("bad", "alignment", text)]
    lost = [f"{a} to {b}" for (a, b), off in zip(pairs, each, strict=True) if off > max(FITS, 3 * given)]
    if lost:
        text = f"{apart}, but far more from {some(lost)}: are these poses right?"
        return [Finding("warn", "alignment", text)]
    return [Finding("ok", "alignment", f"{apart} ({_length(still)} with no poses): poses and scans fit")]


def _motion(relative: Pose) -> float:
    """About how far a point 10 m away moves at most, in m."""
    angle = np.arccos(np.clip((np.trace(relative[:3, :3]) - 1) / 2, -1, 1))
    return float(np.linalg.norm(relative[:3, 3]) + 10 * angle)


def _length(metres: float) -> str:
    return f"{100 * metres:.1f} cm" if metres < REACH else f"over {REACH:g} m"

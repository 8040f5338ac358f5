"""Are poses rigid, and do they and their times go on steadily?"""

import numpy as np
import numpy.typing as npt

from runtime.doctor.findings import Finding
from runtime.errors import PoseError, some
from runtime.recordings.poses import Poses, check_pose

PERIOD = 0.1  # s between scans of SemanticKITTI, and of the simulated streets


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

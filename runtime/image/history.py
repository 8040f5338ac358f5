"""The past scans that a runner looks at, in buffers that are reused."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.manifest import Tuned
from runtime.bundle.residual import HISTORY
from runtime.compute.jit import kernel
from runtime.image.entry import Entered
from runtime.recordings.poses import relative_pose

SPARE, MUCH = 1 << 20, 4  # points of a buffer that is kept whatever happens; times what a scan needs


@dataclass(frozen=True)
class Past:
    """A scan before the current one."""

    points: NDArray[np.float32]  # (M, >=3) m, in its own LiDAR frame; all take part
    relative: NDArray[np.float64]  # (4, 4) T_current_past


class History:
    """A ring of the last `HISTORY` scans with their poses."""

    def __init__(self, limits: Tuned | None = None) -> None:
        """limits: the steps of pose and time that are jumps; None: the defaults."""
        self._limits = limits or Tuned()
        self._buffers = [np.empty((0, 3), np.float32) for _ in range(HISTORY)]
        self._counts = [0] * HISTORY
        self._poses: list[NDArray[np.float64]] = [np.eye(4)] * HISTORY
        self._newest = 0  # slot of the newest scan
        self._length = 0
        self._time: float | None = None

    def __len__(self) -> int:
        return self._length

    def clear(self) -> None:
        """Forget all scans; the buffers stay."""
        self._length = 0
        self._time = None

    def past(self, pose: NDArray[np.float64]) -> list[Past]:
        """The scans 1, 2, ... steps back, for T_world_current = `pose`; views that the next `add` may change."""
        slots = [(self._newest - i) % HISTORY for i in range(self._length)]
        return [Past(self._buffers[at][: self._counts[at]], relative_pose(pose, self._poses[at])) for at in slots]

    def jump(self, pose: NDArray[np.float64], time: float | None) -> str:
        """In what the next scan does not follow the newest one ("" if it does)."""
        if not self._length:
            return ""
        step = relative_pose(pose, self._poses[self._newest])
        distance = float(np.linalg.norm(step[:3, 3]))
        angle = float(np.degrees(np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1))))
        if not distance <= self._limits.jump:
            return f"the pose jumps by {distance:.1f} m"
        if angle > self._limits.turn:
            return f"the pose turns by {angle:.0f} degrees"
        if time is not None and self._time is not None and not 0 < time - self._time <= self._limits.gap:
            return f"the time steps by {time - self._time:.3f} s"
        return ""

    def add(self, scan: Entered, pose: NDArray[np.float64], time: float | None) -> None:
        """Remember the points of a scan that take part; the oldest scan is forgotten."""
        slot = (self._newest + 1) % HISTORY
        count = int(np.count_nonzero(scan.takes_part))
        if not count <= len(self._buffers[slot]) <= max(SPARE, MUCH * count):
            self._buffers[slot] = np.empty((count + count // 8, 3), np.float32)
        _keep(scan.points, scan.takes_part, self._buffers[slot])
        self._counts[slot] = count
        self._poses[slot] = pose.copy()
        self._newest = slot
        self._length = min(self._length + 1, HISTORY)
        self._time = time


@kernel
def _keep(points, keep, out):  # type: ignore[no-untyped-def]
    row = 0
    for i in range(keep.size):
        if keep[i]:
            for axis in range(3):
                out[row, axis] = points[i, axis]
            row += 1

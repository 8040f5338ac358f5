"""The past scans that a runner looks at, in buffers that are reused."""

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.residual import HISTORY
from runtime.compute.jit import kernel
from runtime.recordings.poses import relative_pose

JUMP = 10.0  # m between two scans: 360 km/h at 10 Hz, no drive
TURN = 60.0  # degrees between two scans
GAP = 1.0  # s between two scans


class History:
    """A ring of the last `HISTORY` scans with their poses."""

    def __init__(self) -> None:
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

    def past(self) -> list[NDArray[np.float32]]:
        """Scans 1, 2, ... steps back, (M, 3) f32 m in their own LiDAR frames; views that the next `add` may change."""
        slots = [(self._newest - i) % HISTORY for i in range(self._length)]
        return [self._buffers[slot][: self._counts[slot]] for slot in slots]

    def relative(self, pose: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """T_current_past (4, 4) f64 of each of them, for T_world_current = `pose`."""
        return [relative_pose(pose, self._poses[(self._newest - i) % HISTORY]) for i in range(self._length)]

    def jump(self, pose: NDArray[np.float64], time: float | None) -> str:
        """In what the next scan does not follow the newest one ("" if it does)."""
        if not self._length:
            return ""
        step = self.relative(pose)[0]
        distance = float(np.linalg.norm(step[:3, 3]))
        angle = float(np.degrees(np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1))))
        if distance > JUMP:
            return f"the pose jumps by {distance:.1f} m"
        if angle > TURN:
            return f"the pose turns by {angle:.0f} degrees"
        if time is not None and self._time is not None and not 0 < time - self._time <= GAP:
            return f"the time steps by {time - self._time:.3f} s"
        return ""

    def add(
        self, points: NDArray[np.float32], keep: NDArray[np.bool_], pose: NDArray[np.float64], time: float | None
    ) -> None:
        """Remember the points (N, >=3) f32 where `keep` (N,), of the scan at `pose`; the oldest scan is forgotten."""
        slot = (self._newest + 1) % HISTORY
        count = int(np.count_nonzero(keep))
        if len(self._buffers[slot]) < count:
            self._buffers[slot] = np.empty((count + count // 8, 3), np.float32)
        _keep(points, keep, self._buffers[slot])
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

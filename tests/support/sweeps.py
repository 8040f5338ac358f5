"""Raw sweeps of the simulator, as recordings: each point seen from where the LiDAR was when it was measured."""

import numpy as np

from mos_model.simulator.odometry import true_pose
from mos_model.simulator.sequence import Simulation, simulate
from runtime.recordings.recording import Indexed, Scan

PERIOD = 0.1  # s of a sweep


def drive(seed: int, count: int, motion: str) -> Simulation:
    """A turning drive past what stands still.

    motion: "on": raw; "compensated": brought to the middle, exactly; "off": all at one time.
    """
    plain = {"movers": 0, "imperfections": False, "sensor_variation": False, "pose_noise": 0}
    simulation = simulate(seed, count, "hdl32e", street="urban", ego="turning", scan_motion=motion, **plain)
    simulation._misjudged[:] = 1
    return simulation


class Sweeps(Indexed):
    """Raw sweeps with their times. The stamp and pose of a scan are those of its start, middle or end."""

    sensor, source, poses_from = None, "the simulator", "the simulator"

    def __init__(self, simulation: Simulation, stamp: str = "middle", poses: bool = True, times: bool = True) -> None:
        at = ("start", "middle", "end").index(stamp)
        self.name, self._simulation, self._offset = "sweeps", simulation, PERIOD * (at - 1) / 2
        self._scans = list(simulation)
        self.keys = tuple(f"{index:06d}" for index in range(len(simulation)))
        self.times = simulation.times + self._offset if times else None
        self.poses = np.array([true_pose(state[at]) for state in simulation.states]) if poses else None
        self.poses_from = "the simulator" if poses else None
        self.times_of_points = True

    def read(self, index: int) -> Scan:
        points = self._scans[index].points
        turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)  # of the beams, which begin behind the sensor
        times = (PERIOD * turn - self._offset).astype(np.float32)
        pose = None if self.poses is None else self.poses[index]
        return Scan(
            self.keys[index],
            points,
            pose,
            None if self.times is None else self.times[index],
            times=times if self.times_of_points else None,
        )

"""Simulated streets: LiDAR scans with poses and labels, from NumPy and Numba alone."""

from mos_model.simulator.sequence import Frame, Simulation, simulate
from mos_model.simulator.settings import SimulationSettings
from mos_model.simulator.write import WrittenDataset, write_dataset

__all__ = [
    "Frame",
    "Simulation",
    "SimulationSettings",
    "WrittenDataset",
    "simulate",
    "write_dataset",
]

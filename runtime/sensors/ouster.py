"""Sensors of Ouster, by their data sheets (revision 7), in the mode of 1024 columns."""

from typing import Any

from runtime.sensors.sensor import Sensor, even


def _of_all_sizes(name: str, half: float, **properties: Any) -> tuple[Sensor, ...]:
    """A model with 32, 64 and 128 beams, from `half` degrees above the horizon to as much below."""
    return tuple(Sensor(f"{name}-{n}", even(half, -half, n), 1024, **properties) for n in (32, 64, 128))


OS0 = _of_all_sizes("os0", 45.0, min_range=0.3, range_noise=0.02, max_range=60.0, reach=100.0, sensitivity=6e-6)
OS1 = _of_all_sizes("os1", 21.2, min_range=0.5, range_noise=0.015, max_range=90.0, reach=200.0)
OS2 = _of_all_sizes("os2", 11.25, min_range=0.8, range_noise=0.03, max_range=110.0, reach=400.0, sensitivity=1e-6)

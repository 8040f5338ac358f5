"""The points of one scan as a file or message holds them: remission in its own unit, columns by their usual names."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError, some
from runtime.recordings.scans import ScanData

PLACE = ("x", "y", "z")
REMISSION = ("remission", "intensity", "reflectivity", "i", "scalar_intensity")  # the first that is there is taken
RING = ("ring", "laser_number", "laser_id", "laser", "channel", "line", "beam", "beam_id")
TIME = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "offset_ns",
    "offset_time",
    "time_offset",
    "gps_time",
)

Numbers = npt.NDArray[np.integer] | npt.NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in the order of the file."""

    data: ScanData  # (N, 4) x y z in m, LiDAR frame, and remission in the unit of the file; (N, 3) where there is none
    ring: npt.NDArray[np.integer] | None = None  # (N,) number of the laser
    times: Numbers | None = None  # (N,) when each was measured, in the unit and by the clock of the file


def cloud_of(columns: Mapping[str, npt.NDArray[np.generic]], where: str) -> Cloud:
    """The cloud of columns (N,) by name, in upper or lower case. Raises ScanError, beginning with `where`."""
    by_name = {name.lower(): column for name, column in columns.items()}
    if missing := [name for name in PLACE if name not in by_name]:
        there = some(list(columns), most=12) or "none"
        raise ScanError(f"{where}: has no field {', '.join(missing)}; its fields are {there}")
    remission = next((by_name[name] for name in REMISSION if name in by_name), None)
    ring = next((by_name[name] for name in RING if name in by_name), None)
    times = next((by_name[name] for name in TIME if name in by_name), None)
    used = [by_name[name] for name in PLACE] + ([] if remission is None else [remission])
    data = np.empty((len(used[0]), len(used)), np.float32)
    with np.errstate(over="ignore"):  # float64 beyond the range of float32 becomes infinite
        for index, column in enumerate(used):
            data[:, index] = column
    return Cloud(data, None if ring is None else whole_numbers(ring), None if times is None else _plain(times))


def whole_numbers(values: npt.NDArray[np.generic]) -> npt.NDArray[np.integer] | None:
    """Values (N,) as integers; None where they are none."""
    if np.issubdtype(values.dtype, np.integer):
        return np.asarray(values, np.int64 if values.dtype.itemsize > 4 else np.int32)
    numbers = np.asarray(values, np.float64)
    whole = np.isfinite(numbers).all() and (numbers == np.floor(numbers)).all() and (abs(numbers) < 2**31).all()
    return numbers.astype(np.int32) if whole else None


def _plain(values: npt.NDArray[np.generic]) -> Numbers | None:
    """Values (N,) in the byte order of this machine, without the rows that they are from; None where they are none."""
    if not np.issubdtype(values.dtype, np.integer) and not np.issubdtype(values.dtype, np.floating):
        return None
    return np.ascontiguousarray(values, values.dtype.newbyteorder("="))

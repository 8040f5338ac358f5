"""The points of one scan as a file or message holds them: remission in its own unit, columns by their usual names."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError, some
from runtime.recordings.scans import ScanData

PLACE = ("x", "y", "z")
REMISSION = ("remission", "intensity", "reflectivity", "i", "scalar_intensity")  # the first that is there is taken
RING = ("ring", "laser_number", "laser_id", "channel")


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in the order of the file."""

    data: ScanData  # (N, 4) x y z in m, LiDAR frame, and remission in the unit of the file; (N, 3) where there is none
    ring: npt.NDArray[np.integer] | None = None  # (N,) number of the laser


def cloud_of(columns: Mapping[str, npt.NDArray[np.generic]], where: str) -> Cloud:
    """The cloud of columns (N,) by name, in upper or lower case. Raises ScanError, beginning with `where`."""
    by_name = {name.lower(): column for name, column in columns.items()}
    if missing := [name for name in PLACE if name not in by_name]:
        there = some(list(columns), most=12) or "none"
        raise ScanError(f"{where}: has no field {', '.join(missing)}; its fields are {there}")
    remission = next((by_name[name] for name in REMISSION if name in by_name), None)
    ring = next((by_name[name] for name in RING if name in by_name), None)
    used = [by_name[name] for name in PLACE] + ([] if remission is None else [remission])
    data = np.empty((len(used[0]), len(used)), np.float32)
    with np.errstate(over="ignore"):  # float64 beyond the range of float32 becomes infinite
        for index, column in enumerate(used):
            data[:, index] = column
    return Cloud(data, None if ring is None else whole_numbers(ring))


def whole_numbers(values: npt.NDArray[np.generic]) -> npt.NDArray[np.integer] | None:
    """Values (N,) as integers; None where they are none."""
    if np.issubdtype(values.dtype, np.integer):
        return np.asarray(values, np.int64 if values.dtype.itemsize > 4 else np.int32)
    numbers = np.asarray(values, np.float64)
    whole = np.isfinite(numbers).all() and (numbers == np.floor(numbers)).all() and (abs(numbers) < 2**31).all()
    return numbers.astype(np.int32) if whole else None

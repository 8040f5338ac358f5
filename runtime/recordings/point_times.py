"""When each point of a scan was measured, from the units and clocks in which sensors and files have it."""

import logging
from collections.abc import Callable, Iterable

import numpy as np
import numpy.typing as npt

from runtime.recordings.cloud import Cloud, Numbers

log = logging.getLogger("lidar_mos.recordings")

UNITS = {"s": 1.0, "ms": 1e3, "µs": 1e6, "ns": 1e9}  # in one second
SHORTEST, LONGEST = 0.005, 1.0  # s that a turn takes: less than a factor of 1000, so that a span has one unit
COMMON = (0.01, 0.99)  # quantiles within which the span is taken: points without a return may have any time
APART = 0.5  # s from the time of its scan, up to which a time may be counted from it


class PointTimes:
    """Brings the times of a recording's points to seconds after the time of their scan, all by one unit."""

    def __init__(self, source: str, first: Callable[[], Iterable[Cloud]]) -> None:
        """first: gives the clouds that show the unit; the logger is told where they show none."""
        self._source, self._first = source, first
        self._unit: float | None = None
        self._looked = False

    def seconds(self, times: Numbers | None, scan: float | None) -> npt.NDArray[np.float32] | None:
        """Times of points (N,), as the file has them, in s after `scan`, the time of their scan in s.

        They may be counted from the scan, from where its own time is (of a clock of the sensor, or since 1970), or
        from anything else: then they are in s after the first point. 0 where a point has none, None where they are
        those of no turn.
        """
        if times is None or not len(times) or self.unit is None:
            return None
        values = np.asarray(times, np.float64) / self.unit
        known = np.isfinite(values) & (values != 0)
        if not known.any():
            return None
        middle = np.median(values[known])
        if abs(middle) > APART:
            first = np.min(values[known & (abs(values - middle) <= LONGEST)])
            values -= scan if scan is not None and abs(middle - scan) <= APART else first
        with np.errstate(invalid="ignore"):
            values[~(abs(values) <= LONGEST)] = 0
        return values.astype(np.float32)

    @property
    def unit(self) -> float | None:
        """How many are a second; None where the times of the first clouds are those of no turn."""
        if not self._looked:
            span = max((_span(cloud.times) for cloud in self._first()), default=0.0)
            self._unit = next((one for one in UNITS.values() if SHORTEST <= span / one <= LONGEST), None)
            self._looked = True
            if self._unit is None and span:
                log.info("%s: the times of its points span %.3g, which is no turn: not used", self._source, span)
        return self._unit


def _span(times: Numbers | None) -> float:
    """How far times (N,) go, but for a few wild ones."""
    if times is None or not len(times):
        return 0.0
    values = np.asarray(times, np.float64)
    values = values[np.isfinite(values) & (values != 0)]
    return float(np.subtract(*np.quantile(values, COMMON[::-1], method="nearest"))) if len(values) else 0.0

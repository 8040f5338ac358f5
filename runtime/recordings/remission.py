"""Remission in 0..1, which networks want, from the units in which sensors and files have it."""

import logging
from collections.abc import Callable, Iterable

import numpy as np

from runtime.recordings.cloud import Cloud
from runtime.recordings.scans import ScanData

log = logging.getLogger("lidar_mos.recordings")

# 0..1, and the whole numbers of 8, 12 and 16 bits. Reflectivity in percent is not among them: the 8 bits of many
# sensors stay below 100 too where no sign or number plate is in sight.
FULL_SCALES = (1.0, 255.0, 4095.0, 65535.0)
SEEN = 0.999  # the share of the values that must be within the scale: some are wild
FIRST = 3  # scans that are looked at


class Remission:
    """Brings the remission of a recording's scans to 0..1, all by one scale."""

    def __init__(self, given: float | None, source: str, first: Callable[[], Iterable[Cloud]]) -> None:
        """given: the scale; None: as the clouds that `first` gives show it, which the logger is told."""
        self._given, self._source, self._first = given, source, first
        self._found: float | None = None

    def scaled(self, data: ScanData) -> ScanData:
        """A scan (N, 4) with its remission in 0..1; `data` itself where it is that already, or (N, 3)."""
        if data.shape[1] == 3 or self.scale == 1:
            return data
        scaled = data.copy()
        scaled[:, 3] /= np.float32(self.scale)
        return scaled

    @property
    def scale(self) -> float:
        """By what the remission is divided."""
        if self._given is not None:
            return self._given
        if self._found is None:
            top, self._found = find_scale(cloud.data for cloud in self._first())
            if self._found != 1:
                log.info(
                    "%s: remission goes up to %.3g and is divided by %g; if that is wrong, give its full scale "
                    "(`remission_scale`)",
                    self._source,
                    top,
                    self._found,
                )
        return self._found


def find_scale(scans: Iterable[ScanData]) -> tuple[float, float]:
    """How far remission goes in scans (N, 4), but for a few wild values, and its full scale, of FULL_SCALES."""
    values = np.concatenate([np.zeros(0, np.float32), *(data[:, 3] for data in scans if data.shape[1] == 4)])
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return 0.0, 1.0
    low, top = (float(value) for value in np.quantile(values, [1 - SEEN, SEEN], method="lower"))
    if low < 0:  # is no remission: left as it is, so that whoever checks it sees that
        return top, 1.0
    counts = bool(values.max() > 1) and bool((values == np.floor(values)).all())  # a dark scene, in whole numbers
    scales = FULL_SCALES[1:] if counts else FULL_SCALES
    return top, next((scale for scale in scales if top <= scale), scales[-1])

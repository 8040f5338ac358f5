"""What one scan shows to the checks: its ranges, elevations, remissions, and the ground."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from statistics import median

import numpy as np
import numpy.typing as npt

from runtime.doctor.ground import Ground, find_ground

FEWEST = 50  # usable points that tell anything of a scan
STEEP = 60.0  # degrees of elevation beyond which no usual sensor looks

Values = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Sample:
    """Some points of one scan, or all. The arrays hold only usable ones: finite, and not at the origin."""

    points: int  # of the scan
    infinite: float  # share of points with NaN or infinity in x, y or z
    origin: float  # share of points at the origin
    xyz: Values  # (M, 3) m
    ranges: Values  # (M,) m
    remissions: Values | None  # (M,), NaN or infinity where a point has none; None: the scan has none

    @classmethod
    def of(cls, scan: npt.NDArray[np.floating], most: int | None = None) -> "Sample":
        """Of a scan (N, 4), or (N, 3) without remission; of about `most` of its points, or all."""
        with np.errstate(over="ignore", invalid="ignore"):
            some = (scan if most is None or len(scan) <= most else scan[_drawn(len(scan), most)]).astype(np.float32)
            squares = some[:, :3] * some[:, :3]
            ranges = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])
        finite, at_origin = np.isfinite(ranges), ranges == 0
        usable = finite & ~at_origin
        return cls(
            points=len(scan),
            infinite=_share(~finite),
            origin=_share(at_origin),
            xyz=some[usable, :3],
            ranges=ranges[usable],
            remissions=some[usable, 3] if scan.shape[1] == 4 else None,
        )

    @property
    def tells(self) -> bool:
        """Whether enough points are usable to say anything."""
        return len(self.ranges) >= FEWEST

    @cached_property
    def sorted_ranges(self) -> Values:
        return np.sort(self.ranges)

    @cached_property
    def middle(self) -> float:
        """Median range in m."""
        return quantile(self.sorted_ranges, 0.5)

    @cached_property
    def known_remissions(self) -> Values:
        """Those that are finite, in order."""
        values = np.empty(0, np.float32) if self.remissions is None else self.remissions
        return np.sort(values[np.isfinite(values)])

    @cached_property
    def elevations(self) -> Values:
        """(M,) degrees, in order."""
        return np.sort(np.degrees(np.arcsin(np.clip(self.xyz[:, 2] / self.ranges, -1, 1))))

    @property
    def steep(self) -> float:
        """Share of points far above or below the sensor."""
        return share_below(self.elevations, -STEEP) + 1 - share_below(self.elevations, STEEP)

    @cached_property
    def ground(self) -> Ground | None:
        return find_ground(self.xyz, self.ranges, self.middle)


def _drawn(count: int, most: int) -> npt.NDArray[np.intp]:
    """Numbers of points, in order and always the same; at equal steps they would meet the same few beams."""
    return (_fractions(most) * count).astype(np.intp)


@cache
def _fractions(count: int) -> npt.NDArray[np.float64]:
    return np.sort(np.random.default_rng(0).random(count))


def quantile(ordered: Values, share: float) -> float:
    """The value below which this share of the values in order lies."""
    return float(ordered[int(share * (len(ordered) - 1))])


def share_below(ordered: Values, limit: float) -> float:
    """Share of the values in order that are below a limit."""
    return int(np.searchsorted(ordered, limit)) / max(1, len(ordered))


def middle(values: Iterable[float]) -> float:
    """The median, so that no single sample decides. At least one value."""
    return float(median(values))


def _share(mask: npt.NDArray[np.bool_]) -> float:
    return int(np.count_nonzero(mask)) / max(1, len(mask))

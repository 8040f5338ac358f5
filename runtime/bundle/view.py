"""The view: from where an image network looks at the scans of a sensor, and at which past ones."""

from dataclasses import dataclass

from runtime.bundle.residual import Residual
from runtime.errors import SettingError
from runtime.sensors.range_image import MOST_PIXELS, RangeImage
from runtime.sensors.sensor import FARTHEST

SCAN_CHANNELS = 5  # of the current scan, which come first
PAST_CHANNELS = 4  # of each past scan in a bird's-eye view; in a range image it is one, the residual


@dataclass(frozen=True)
class BirdView:
    """A square around the sensor, seen from above: ahead is up, left is left. Points outside of it have no pixel."""

    cells: int = 512  # a side, a multiple of 16
    cell_size: float = 0.2  # m
    bottom: float = -5.0  # m, lowest z that is seen; the origin is the sensor
    top: float = 3.0  # m, z from which on nothing is seen: crowns of trees would hide what is below

    def __post_init__(self) -> None:
        if self.cells < 16 or self.cells % 16 or self.cells**2 > MOST_PIXELS:
            raise SettingError(
                f"a bird's-eye view has a multiple of 16 cells a side, {MOST_PIXELS:,} at most, not {self.cells!r}"
            )
        if not 0.01 <= self.cell_size <= 10:
            raise SettingError(f"a cell of a bird's-eye view must be 0.01 m to 10 m wide, not {self.cell_size!r}")
        if not -FARTHEST <= self.bottom < self.top <= FARTHEST:
            raise SettingError(
                f"a bird's-eye view must reach from bottom up to top, within {FARTHEST:g} m of the sensor, not "
                f"{self.bottom!r} to {self.top!r}"
            )


@dataclass(frozen=True)
class View:
    """What a network is shown: images of `shape` in which a point has one pixel, or none."""

    range_image: RangeImage  # of the sensor
    residual: Residual  # its lags are the past scans that are shown
    bird: BirdView | None = None  # None: the view from the sensor, the range image

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, height and width of an image."""
        past = len(self.residual.lags)
        if self.bird is None:
            return SCAN_CHANNELS + past, self.range_image.height, self.range_image.width
        return SCAN_CHANNELS + PAST_CHANNELS * past, self.bird.cells, self.bird.cells

    @property
    def closed(self) -> bool:
        """Whether the last column of an image is beside the first."""
        return self.bird is None

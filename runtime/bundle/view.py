"""The view: from where an image network looks at the scans of a sensor, and at which past ones."""

import math
from dataclasses import dataclass

from runtime.bundle.residual import Residual
from runtime.errors import SettingError
from runtime.sensors.range_image import MOST_PIXELS, RangeImage
from runtime.sensors.sensor import FARTHEST

MOST_CELLS = 1 << 24  # of a cylinder: float32 counts them
POINT_CHANNELS = 10  # of a point in a cylinder; the number of its cell follows
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
class CylinderView:
    """A cylinder around the sensor, in cells of equal angles. Points outside of it have no cell.

    A network is shown the points of the scan, and those of the past scans as seen now, one column of an image of one
    row each: see `runtime.image.cylinder_inputs`.
    """

    rings: int = 480  # cells from the axis outwards
    sectors: int = 360  # cells around; the first and the last meet behind the sensor, and are no neighbours
    layers: int = 32  # cells from the bottom up
    radius: float = 50.0  # m
    bottom: float = -4.0  # m, lowest z; the origin is the sensor
    top: float = 2.0  # m

    def __post_init__(self) -> None:
        if min(self.cells) < 1 or math.prod(self.cells) > MOST_CELLS:
            raise SettingError(
                f"a cylinder has rings, sectors and layers of at least 1 cell, {MOST_CELLS:,} cells in all at most, "
                f"not {' x '.join(map(str, self.cells))}"
            )
        if not 0.1 <= self.radius <= FARTHEST:
            raise SettingError(f"the radius of a cylinder must be 0.1 m to {FARTHEST:g} m, not {self.radius!r}")
        if not -FARTHEST <= self.bottom < self.top <= FARTHEST:
            raise SettingError(
                f"a cylinder must reach from bottom up to top, within {FARTHEST:g} m of the sensor, not "
                f"{self.bottom!r} to {self.top!r}"
            )

    @property
    def cells(self) -> tuple[int, int, int]:
        """Cells on each axis; the last varies fastest in the number of a cell."""
        return self.rings, self.sectors, self.layers


@dataclass(frozen=True)
class View:
    """What a network is shown: images of `shape` in which a point has one pixel, or none."""

    range_image: RangeImage  # of the sensor
    residual: Residual  # its lags are the past scans that are shown
    bird: BirdView | None = None  # from above
    cylinder: CylinderView | None = None  # point by point; neither: from the sensor, the range image

    def __post_init__(self) -> None:
        if self.bird is not None and self.cylinder is not None:
            raise SettingError("a network looks from above (bird) or at points in a cylinder, not at both")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, height and width of an image; of points in a cylinder there are as many columns as points, and the
        width is that of the cylinder in sectors."""
        past = len(self.residual.lags)
        if self.cylinder is not None:
            return POINT_CHANNELS + 1, 1, self.cylinder.sectors
        if self.bird is None:
            return SCAN_CHANNELS + past, self.range_image.height, self.range_image.width
        return SCAN_CHANNELS + PAST_CHANNELS * past, self.bird.cells, self.bird.cells

    @property
    def closed(self) -> bool:
        """Whether the last column of an image is beside the first."""
        return self.bird is None

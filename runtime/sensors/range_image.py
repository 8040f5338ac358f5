"""The range image: a sensor's turn as a picture, and the normalisation of its channels."""

from dataclasses import dataclass
from itertools import pairwise

from runtime.errors import SettingError

MOST_PIXELS = 1 << 22  # of an image: its input takes 0.2 GB, and kernels count its pixels in float32
NARROWEST = 0.1  # degrees, of a field of view
LARGEST = 1e6  # of the numbers that normalise, and their least: float32 holds what comes of them


@dataclass(frozen=True)
class RangeImage:
    """Spherical range image (paper, eq. 1) and the normalisation of its five channels. Default: HDL-64E."""

    height: int = 64  # rows, a multiple of 16
    width: int = 2048  # columns over 360 degrees, a multiple of 16
    fov_up: float = 3.0  # degrees, upper edge of the first row
    fov_down: float = -25.0  # degrees, lower edge of the last row
    mean: tuple[float, ...] = (12.12, 10.88, 0.23, -1.04, 0.21)  # range, x, y, z in m, remission
    std: tuple[float, ...] = (12.32, 11.47, 6.91, 0.86, 0.16)
    elevations: tuple[float, ...] = ()  # degrees, of each row's beam from the top down; empty: rows at equal angles

    def __post_init__(self) -> None:
        for name in ("height", "width"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 16 or value % 16:
                raise SettingError(f"sensor {name} must be a positive multiple of 16, not {value!r}")
        if self.height * self.width > MOST_PIXELS:
            raise SettingError(
                f"a range image has up to {MOST_PIXELS:,} pixels, not {self.height!r} x {self.width!r} of them"
            )
        if not (self.fov_down >= -90 and self.fov_up <= 90 and self.fov_up - self.fov_down >= NARROWEST):
            raise SettingError(
                f"sensor field of view must rise from fov_down to fov_up within -90..90 degrees, by {NARROWEST} at "
                f"least, not {self.fov_down!r} to {self.fov_up!r}"
            )
        rows = self.elevations
        if rows and (len(rows) > self.height or not all(a > b for a, b in pairwise((90.1, *rows, -90.1)))):
            raise SettingError(f"sensor elevations must fall, one for each of up to {self.height} rows, not {rows!r}")
        if rows and not (rows[0] <= self.fov_up and self.fov_down <= rows[-1]):
            raise SettingError(f"sensor elevations must lie within the field of view, not {rows[0]!r} to {rows[-1]!r}")
        if len(self.mean) != 5 or not all(abs(value) <= LARGEST for value in self.mean):
            raise SettingError(f"sensor mean must have five values within +-{LARGEST:g}, not {self.mean!r:.100}")
        if len(self.std) != 5 or not all(1 / LARGEST <= value <= LARGEST for value in self.std):
            raise SettingError(
                f"sensor std must have five values of {1 / LARGEST:g} to {LARGEST:g}, not {self.std!r:.100}"
            )

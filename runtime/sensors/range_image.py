"""The range image: a sensor's turn as a picture, and the normalisation of its channels."""

from dataclasses import dataclass

from runtime.errors import SettingError


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
        if not -90 <= self.fov_down < self.fov_up <= 90:
            raise SettingError(
                f"sensor field of view must rise from fov_down to fov_up within -90..90 degrees, "
                f"not {self.fov_down!r} to {self.fov_up!r}"
            )
        rows = self.elevations
        if rows and (len(rows) > self.height or list(rows) != sorted(set(rows), reverse=True)):
            raise SettingError(f"sensor elevations must fall, one for each of up to {self.height} rows, not {rows!r}")
        if rows and not (rows[0] <= self.fov_up and self.fov_down <= rows[-1]):
            raise SettingError(f"sensor elevations must lie within the field of view, not {rows[0]!r} to {rows[-1]!r}")
        if len(self.mean) != 5 or len(self.std) != 5 or min(self.std) <= 0:
            raise SettingError("sensor mean and std must have five values each, std above 0")

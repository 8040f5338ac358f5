"""Residual images: which past scans a network compares the current one with (paper, Sec. III-A)."""

from dataclasses import dataclass

from runtime.errors import SettingError
from runtime.sensors.sensor import FARTHEST

HISTORY = 8  # past scans that a network may look at
NEAREST = 0.01  # m: a residual is a share of the range, and no bound would be left to it


@dataclass(frozen=True)
class Residual:
    """Residual images (paper, eq. 2): the current scan against scans `lags` steps back."""

    lags: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)  # scans back, one channel each
    min_range: float = 2.0  # m, points nearer than this leave no residual
    max_range: float = 50.0  # m, points farther than this leave no residual
    kind: str = "absolute"  # "absolute": |r_cur - r_prev| / r_cur as published; "signed": (r_prev - r_cur) / r_cur

    def __post_init__(self) -> None:
        lags = self.lags
        if not lags or list(lags) != sorted(set(lags)) or lags[0] < 1 or lags[-1] > HISTORY:
            raise SettingError(f"residual lags must rise within 1..{HISTORY}, not {lags!r}")
        if not NEAREST <= self.min_range < self.max_range <= FARTHEST:
            raise SettingError(f"residual limits must satisfy {NEAREST} <= min_range < max_range <= {FARTHEST:g}")
        if self.kind not in ("absolute", "signed"):
            raise SettingError(f"residual kind must be 'absolute' or 'signed', not {self.kind!r}")

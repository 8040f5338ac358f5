"""Which network: one frozen description that builds it, names it in checkpoints and bundles, and compares."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, TypeVar

from runtime.bundle.head_shape import FULL, LITE, SMALL, PointHeadConfig
from runtime.bundle.residual import Residual
from runtime.errors import SettingError
from runtime.sensors.range_image import RangeImage

T = TypeVar("T")

NETWORKS = ("dual", "lmnet", "rt")
POOLINGS = ("average", "soft")


@dataclass(frozen=True)
class ModelConfig:
    """A network. Default: the published image network, "v1" (paper, Sec. III; row e of the ablation)."""

    name: str = "v1"  # how tables and bundles call it
    network: str = "dual"  # "dual": two branches with attention; "lmnet": one branch; "rt": for real time
    channels: int = 32  # width c of the image features, even
    sensor: RangeImage = field(default_factory=RangeImage)
    residual: Residual = field(default_factory=Residual)
    pooling: str = "soft"  # "soft": SoftPool; "average": 3x3 average, stride 2
    meta_kernel: bool = True  # geometry-aware convolution in the appearance encoder ("dual" only)
    point_head: PointHeadConfig | None = None  # None: image network alone
    rt_widths: tuple[int, ...] = ()  # channels of the stages of "rt"; (): its own default

    def __post_init__(self) -> None:
        if self.network not in NETWORKS:
            raise SettingError(f"network must be one of {', '.join(NETWORKS)}, not {self.network!r}")
        if self.pooling not in POOLINGS:
            raise SettingError(f"pooling must be one of {', '.join(POOLINGS)}, not {self.pooling!r}")
        if type(self.channels) is not int or self.channels < 2 or self.channels % 2:
            raise SettingError(f"channels must be an even whole number of at least 2, not {self.channels!r}")
        if self.meta_kernel and self.network != "dual":
            raise SettingError(f"network {self.network!r} has no MetaKernel: set meta_kernel=False")
        if self.rt_widths and self.network != "rt":
            raise SettingError(f"rt_widths belong to network 'rt', not to {self.network!r}")
        if self.point_head is not None and self.point_head.in_channels != self.channels:
            raise SettingError(
                f"the point head takes {self.point_head.in_channels} channels but the image network gives "
                f"{self.channels}: set in_channels of the head to {self.channels}"
            )

    @property
    def in_channels(self) -> int:
        """Channels of the input image: range, x, y, z, remission, and one residual image per lag."""
        return 5 + len(self.residual.lags)

    def to_dict(self) -> dict[str, Any]:
        """Plain values (lists for tuples): what JSON returns is equal to what it was given."""
        return _plain(asdict(self))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "ModelConfig":
        """Inverse of `to_dict`; a missing key takes its default. Raises SettingError on an unknown key."""
        _check_keys(cls, values, "model")
        parts = dict(values)
        for key, kind in (("sensor", RangeImage), ("residual", Residual), ("point_head", PointHeadConfig)):
            if parts.get(key) is not None:
                parts[key] = _build(kind, parts[key], key)
        return _build(cls, parts, "model")


# Rows of the paper's ablation table, by what they change of v1.
_NAMED: dict[str, dict[str, Any]] = {
    "lmnet": {"network": "lmnet", "pooling": "average", "meta_kernel": False},
    "b": {"pooling": "average", "meta_kernel": False},
    "c": {"meta_kernel": False},
    "d": {"pooling": "average"},
    "e": {},
    "v1": {},
    "v2": {"point_head": FULL},
    "v2-lite": {"point_head": LITE},
    "rt": {
        "network": "rt",
        "pooling": "average",
        "meta_kernel": False,
        "residual": Residual(kind="signed"),
    },
}
_NAMED["rt-head"] = _NAMED["rt"] | {"point_head": SMALL}
NAMES = tuple(_NAMED)


def named_config(name: str, /, channels: int = 32, **changes: Any) -> ModelConfig:
    """A configuration of the paper by its name, at any width; `changes` are fields of `ModelConfig`.

    The point head takes the image network's features, so its `in_channels` follows `channels`.
    """
    if name not in _NAMED:
        raise SettingError(f"no network is called {name!r}; there are {', '.join(NAMES)}")
    _check_keys(ModelConfig, changes, f"changes of {name!r}")
    settings = {"name": name, "channels": channels} | _NAMED[name] | changes
    head = settings.get("point_head")
    if head is not None:
        settings["point_head"] = replace(head, in_channels=channels)
    return ModelConfig(**settings)


def differing_fields(a: ModelConfig, b: ModelConfig) -> list[str]:
    """What differs, one readable line per field: "sensor.width: 2048 against 1024"."""
    return _differences(a.to_dict(), b.to_dict(), "")


def _differences(a: Mapping[str, Any], b: Mapping[str, Any], prefix: str) -> list[str]:
    lines: list[str] = []
    for key in a:
        if isinstance(a[key], Mapping) and isinstance(b[key], Mapping):
            lines += _differences(a[key], b[key], f"{prefix}{key}.")
        elif a[key] != b[key]:
            lines.append(f"{prefix}{key}: {a[key]!r} against {b[key]!r}")
    return lines


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _check_keys(kind: type, values: Mapping[str, Any], where: str) -> None:
    if not isinstance(values, Mapping):
        raise SettingError(f"{where}: expected a mapping of settings, not {type(values).__name__}")
    unknown = sorted(map(str, set(values) - {f.name for f in fields(kind)}))
    if unknown:
        raise SettingError(f"{where}: unknown setting {', '.join(unknown)} (written by a newer version?)")


def _build(kind: type[T], values: Mapping[str, Any], where: str) -> T:
    _check_keys(kind, values, where)
    settings = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
    try:
        return kind(**settings)
    except TypeError as error:  # a value of the wrong type, met while it was checked
        raise SettingError(f"{where}: {error}") from error

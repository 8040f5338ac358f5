"""What all networks are told: a frozen description that builds the network, names it in files, and compares.

The file of each network adds its own settings and its module; `registry.py` lists them.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from torch import nn

from mos_model.networks.point_head import PointHead
from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.residual import Residual
from runtime.bundle.view import View
from runtime.errors import SettingError
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import DEFAULT_SENSOR, find_sensor


@dataclass(frozen=True)
class ModelConfig(ABC):
    """A network: an image network of some kind, and perhaps a point head."""

    kind: ClassVar[str]  # of the image network, in checkpoints and bundles
    named: ClassVar[Mapping[str, Mapping[str, Any]]]  # for `mos train --config`: what each name changes of the defaults
    channels_last: ClassVar[bool] = False  # whether it trains faster with the channels last in memory, on a CPU

    name: str  # how tables and bundles call it
    channels: int = 32  # width c of the image features, even
    sensor: str = DEFAULT_SENSOR  # by its name: what is simulated for it, and how far returns reach
    other_sensors: tuple[str, ...] = ()  # that it is for too, by their names, each with its own range image
    range_image: RangeImage = field(default_factory=RangeImage)
    residual: Residual = field(default_factory=Residual)
    point_head: PointHeadConfig | None = None  # None: image network alone

    def __post_init__(self) -> None:
        for name in (self.sensor, *self.other_sensors):
            find_sensor(name)
        if type(self.channels) is not int or self.channels < 2 or self.channels % 2:
            raise SettingError(f"channels must be an even whole number of at least 2, not {self.channels!r}")
        if self.point_head is not None and self.point_head.in_channels != self.channels:
            raise SettingError(
                f"the point head takes {self.point_head.in_channels} channels but the image network gives "
                f"{self.channels}: set in_channels of the head to {self.channels}"
            )

    @abstractmethod
    def build_image_network(self) -> nn.Module:
        """The image network: forward(image (B, *view.shape) float32) -> ImageOutput; H and W any multiples of 16."""

    def build_point_head(self) -> PointHead | None:
        """The point head: forward(grid, features (N, c)) -> logits (N, 3); None where there is none."""
        return None if self.point_head is None else PointHead(self.point_head)

    @property
    def view(self) -> View:
        """What the network is shown; another view than that from the sensor is a setting of its own networks."""
        return View(self.range_image, self.residual)

    @property
    def postprocess(self) -> str:
        """From pixels to points, unless told otherwise: the vote is for what is hidden in a range image."""
        if self.point_head is not None:
            return "head"
        return "knn" if self.view.bird is None and self.view.cylinder is None else "none"

    @property
    def in_channels(self) -> int:
        """Channels of the input image: those of the scan, then those of its past."""
        return self.view.shape[0]

    def to_dict(self) -> dict[str, Any]:
        """Plain values (lists for tuples): JSON returns what it was given. `registry.read_config` is the inverse."""
        return {"kind": self.kind, **{key: _plain(value) for key, value in asdict(self).items()}}


def differences(a: ModelConfig, b: ModelConfig, ignored: tuple[str, ...] = ()) -> list[str]:
    """What differs but for the settings `ignored`, a readable line each: "range_image.width: 2048 against 1024"."""
    one, other = ({key: v for key, v in config.to_dict().items() if key not in ignored} for config in (a, b))
    return _differences(one, other, "")


def _differences(a: Mapping[str, Any], b: Mapping[str, Any], prefix: str) -> list[str]:
    lines: list[str] = []
    for key in {**a, **b}:
        one, other = a.get(key), b.get(key)  # None: the other kind of network has no such setting
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            lines += _differences(one, other, f"{prefix}{key}.")
        elif one != other:
            lines.append(f"{prefix}{key}: {one!r} against {other!r}")
    return lines


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value

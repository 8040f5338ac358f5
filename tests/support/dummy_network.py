"""A network that is not the product's, as CONTRIBUTING says to add one: this file, and a line in the registry."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from mos_model.networks.config import ModelConfig
from mos_model.networks.image_output import ImageOutput
from runtime.classes import CLASSES


@dataclass(frozen=True)
class DummyConfig(ModelConfig):
    """One convolution."""

    kind: ClassVar[str] = "dummy"
    named: ClassVar[Mapping[str, Mapping[str, Any]]] = {"dummy": {}, "dummy-5x5": {"size": 5}}

    name: str = "dummy"
    size: int = 3  # pixels, of the kernel

    def build_image_network(self) -> nn.Module:
        """See `ModelConfig`."""
        return DummyNet(self)


class DummyNet(nn.Module):
    """Every pixel for itself and its neighbours."""

    def __init__(self, config: DummyConfig) -> None:
        super().__init__()
        self.conv = nn.Conv2d(config.in_channels, config.channels, config.size, padding=config.size // 2)
        self.logits = nn.Conv2d(config.channels, len(CLASSES), 1)

    def forward(self, image: Tensor) -> ImageOutput:
        """image (B, 5 + L, H, W) float32."""
        features = torch.relu(self.conv(image))  # (B, c, H, W)
        return ImageOutput(self.logits(features), features)

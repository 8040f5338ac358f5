"""LMNet on SalsaNext: the paper's baseline, one branch over all channels."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor, nn

from mos_model.networks.image_output import ImageOutput
from mos_model.networks.unet import UNet, UNetConfig
from runtime.classes import CLASSES


@dataclass(frozen=True)
class LMNetConfig(UNetConfig):
    """Row a of the paper's ablation table."""

    kind: ClassVar[str] = "lmnet"
    named: ClassVar[Mapping[str, Mapping[str, Any]]] = {"lmnet": {}}

    name: str = "lmnet"
    pooling: str = "average"

    def build_image_network(self) -> nn.Module:
        """See `ModelConfig`."""
        return LMNet(self)


class LMNet(UNet):
    """Range and residual images enter side by side."""

    def __init__(self, config: LMNetConfig) -> None:
        super().__init__(config.in_channels, config.channels, config.pooling)
        self.logits = nn.Conv2d(config.channels, len(CLASSES), 1)

    def forward(self, image: Tensor) -> ImageOutput:
        """image (B, 5 + L, H, W) float32, H and W multiples of 16."""
        x = image
        for block in self.context:
            x = block(x)  # (B, c, H, W)
        skips = []
        for block in self.encoder:
            x, skip = block(x)  # (B, 2c, H/2, W/2) ... (B, 8c, H/16, W/16); the skip is twice as high and wide
            skips.append(skip)
        features = self.decode(x, skips)  # (B, c, H, W)
        return ImageOutput(self.logits(features), features)

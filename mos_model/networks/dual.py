"""The paper's network: appearance (range image) guided by motion (residual images) at five scales (Fig. 2)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor, nn

from mos_model.networks.blocks import ContextBlock, MetaKernel, MotionGuidedAttention
from mos_model.networks.image_output import ImageOutput
from mos_model.networks.unet import UNet, UNetConfig, encoder
from runtime.bundle.head_shape import FULL, LITE
from runtime.bundle.view import SCAN_CHANNELS
from runtime.classes import CLASSES


@dataclass(frozen=True)
class DualConfig(UNetConfig):
    """Rows b to e of the paper's ablation table. Default: the published image network, "v1", which is row e."""

    kind: ClassVar[str] = "dual"
    named: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "b": {"pooling": "average", "meta_kernel": False},
        "c": {"meta_kernel": False},
        "d": {"pooling": "average"},
        "e": {},
        "v1": {},
        "v2": {"point_head": FULL},
        "v2-lite": {"point_head": LITE},
    }

    name: str = "v1"
    meta_kernel: bool = True  # geometry-aware convolution among the first of the appearance branch

    def build_image_network(self) -> nn.Module:
        """See `ModelConfig`."""
        return DualBranchNet(self)


class DualBranchNet(UNet):
    """Two branches with motion-guided attention."""

    def __init__(self, config: DualConfig) -> None:
        c = config.channels
        super().__init__(SCAN_CHANNELS, c, config.pooling)
        self.meta_kernel = MetaKernel(c) if config.meta_kernel else None
        self.motion_context = ContextBlock(len(config.residual.lags), c)
        self.motion_encoder = encoder(c, config.pooling)
        self.attention = nn.ModuleList(MotionGuidedAttention(width) for width in (c, 2 * c, 4 * c, 8 * c, 8 * c))
        self.logits = nn.Conv2d(c, len(CLASSES), 1)

    def forward(self, image: Tensor) -> ImageOutput:
        """image (B, 5 + L, H, W) float32, H and W multiples of 16."""
        first, *motion = self.encode_motion(image[:, SCAN_CHANNELS:])  # at 1/1; at 1/2, 1/4, 1/8, 1/16
        x = self.encode_context(image[:, :SCAN_CHANNELS])  # (B, c, H, W)
        x = self.attention[0](x, first)  # (B, c, H, W)
        skips = []
        for block, attention, m in zip(self.encoder, self.attention[1:], motion, strict=True):
            x, skip = block(x)  # (B, 2c, H/2, W/2) ... (B, 8c, H/16, W/16); the skip is twice as high and wide
            x = attention(x, m)  # the same shape
            skips.append(skip)
        features = self.decode(x, skips)  # (B, c, H, W)
        return ImageOutput(self.logits(features), features)

    def encode_motion(self, residuals: Tensor) -> list[Tensor]:
        """Residual images (B, L, H, W) to motion features at five scales."""
        maps = [self.motion_context(residuals)]  # (B, c, H, W)
        for block in self.motion_encoder:
            x, _ = block(maps[-1])  # (B, 2c, H/2, W/2), (B, 4c, H/4, W/4), (B, 8c, H/8, W/8), (B, 8c, H/16, W/16)
            maps.append(x)
        return maps

    def encode_context(self, scan: Tensor) -> Tensor:
        """Range image (B, 5, H, W), normalised, to appearance features (B, c, H, W)."""
        first, second, third = self.context
        x: Tensor = first(scan)  # (B, c, H, W)
        if self.meta_kernel is not None:
            x = self.meta_kernel(scan, x)  # (B, c, H, W)
        x = third(second(x))  # (B, c, H, W)
        return x

"""The image networks: range and residual images in, class scores and features of every pixel out."""

from typing import NamedTuple

from torch import Tensor, nn

from mos_model.networks.blocks import ContextBlock, MetaKernel, ResBlock, UpBlock, motion_guided_attention
from mos_model.networks.config import ModelConfig
from runtime.classes import CLASSES

# Tensors of published dual-branch checkpoints that the published network never uses.
UNUSED_PREFIXES = (
    "RI_resBlock5.",
    "RI_upBlock1.",
    "RI_upBlock2.",
    "RI_upBlock3.",
    "RI_upBlock4.",
    "conv1x1_layer4_",
)


class ImageOutput(NamedTuple):
    """What an image network returns."""

    logits: Tensor  # (B, 3, H, W) scores of the classes before softmax
    features: Tensor  # (B, c, H, W / s) for the point head: s neighbouring pixels of a row share theirs

    def features_at(self, image: int, pixel: Tensor) -> Tensor:
        """Features (N, c) of the pixels v * W + u (N,) of one image of the batch."""
        share = self.logits.shape[3] // self.features.shape[3]
        return self.features[image].flatten(1)[:, pixel // share].T


class UNet(nn.Module):
    """What both networks share; the names of attributes are those of the published checkpoints."""

    def __init__(self, in_channels: int, c: int, pool: str) -> None:
        super().__init__()
        self.downCntx = ContextBlock(in_channels, c)
        self.downCntx2 = ContextBlock(c, c)
        self.downCntx3 = ContextBlock(c, c)
        self.resBlock1 = ResBlock(c, 2 * c, pool, dropout=0)
        self.resBlock2 = ResBlock(2 * c, 4 * c, pool)
        self.resBlock3 = ResBlock(4 * c, 8 * c, pool)
        self.resBlock4 = ResBlock(8 * c, 8 * c, pool)
        self.resBlock5 = ResBlock(8 * c, 8 * c, None)
        self.upBlock1 = UpBlock(8 * c, 4 * c)
        self.upBlock2 = UpBlock(4 * c, 4 * c)
        self.upBlock3 = UpBlock(4 * c, 2 * c)
        self.upBlock4 = UpBlock(2 * c, c, dropout=0)

    def decode(self, x: Tensor, skips: tuple[Tensor, Tensor, Tensor, Tensor]) -> Tensor:
        """From (B, 8c, H/16, W/16) and the skips at 1/1, 1/2, 1/4, 1/8 to the features (B, c, H, W)."""
        x = self.upBlock1(x, skips[3])  # (B, 4c, H/8, W/8)
        x = self.upBlock2(x, skips[2])  # (B, 4c, H/4, W/4)
        x = self.upBlock3(x, skips[1])  # (B, 2c, H/2, W/2)
        return self.upBlock4(x, skips[0])  # (B, c, H, W)


class LMNet(UNet):
    """The paper's baseline: one branch over all channels (LMNet on SalsaNext)."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__(config.in_channels, config.channels, config.pooling)
        self.logits = nn.Conv2d(config.channels, len(CLASSES), 1)

    def forward(self, image: Tensor) -> ImageOutput:
        """image (B, 5 + L, H, W) float32, H and W multiples of 16."""
        x = self.downCntx3(self.downCntx2(self.downCntx(image)))  # (B, c, H, W)
        x, skip0 = self.resBlock1(x)  # (B, 2c, H/2, W/2), (B, 2c, H, W)
        x, skip1 = self.resBlock2(x)  # (B, 4c, H/4, W/4), (B, 4c, H/2, W/2)
        x, skip2 = self.resBlock3(x)  # (B, 8c, H/8, W/8), (B, 8c, H/4, W/4)
        x, skip3 = self.resBlock4(x)  # (B, 8c, H/16, W/16), (B, 8c, H/8, W/8)
        x = self.resBlock5(x)  # (B, 8c, H/16, W/16)
        features = self.decode(x, (skip0, skip1, skip2, skip3))  # (B, c, H, W)
        return ImageOutput(self.logits(features), features)


class DualBranchNet(UNet):
    """Appearance (range image) guided by motion (residual images) at five scales (paper, Fig. 2)."""

    def __init__(self, config: ModelConfig) -> None:
        c, pool = config.channels, config.pooling
        super().__init__(5, c, pool)
        if config.meta_kernel:
            self.metaConv = MetaKernel(c)
        self.meta_kernel = config.meta_kernel
        self.RI_downCntx = ContextBlock(len(config.residual.lags), c)
        self.RI_resBlock1 = ResBlock(c, 2 * c, pool, dropout=0)
        self.RI_resBlock2 = ResBlock(2 * c, 4 * c, pool)
        self.RI_resBlock3 = ResBlock(4 * c, 8 * c, pool)
        self.RI_resBlock4 = ResBlock(8 * c, 8 * c, pool)
        for level, width in {
            "conv1": c,
            "layer0": 2 * c,
            "layer1": 4 * c,
            "layer2": 8 * c,
            "layer3": 8 * c,
        }.items():
            setattr(self, f"conv1x1_{level}_spatial", nn.Conv2d(width, 1, 1))
            setattr(self, f"conv1x1_{level}_channel_wise", nn.Conv2d(width, width, 1))
        self.logits3 = nn.Conv2d(c, len(CLASSES), 1)

    def forward(self, image: Tensor) -> ImageOutput:
        """image (B, 5 + L, H, W) float32, H and W multiples of 16."""
        m0, m1, m2, m3, m4 = self.encode_motion(image[:, 5:])  # at 1/1, 1/2, 1/4, 1/8, 1/16
        x = self.encode_context(image[:, :5])  # (B, c, H, W)
        x = self.attend("conv1", x, m0)
        x, skip0 = self.resBlock1(x)  # (B, 2c, H/2, W/2), (B, 2c, H, W)
        x = self.attend("layer0", x, m1)
        x, skip1 = self.resBlock2(x)  # (B, 4c, H/4, W/4), (B, 4c, H/2, W/2)
        x = self.attend("layer1", x, m2)
        x, skip2 = self.resBlock3(x)  # (B, 8c, H/8, W/8), (B, 8c, H/4, W/4)
        x = self.attend("layer2", x, m3)
        x, skip3 = self.resBlock4(x)  # (B, 8c, H/16, W/16), (B, 8c, H/8, W/8)
        x = self.attend("layer3", x, m4)
        x = self.resBlock5(x)  # (B, 8c, H/16, W/16)
        features = self.decode(x, (skip0, skip1, skip2, skip3))  # (B, c, H, W)
        return ImageOutput(self.logits3(features), features)

    def encode_motion(self, residuals: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Residual images (B, L, H, W) to motion features at five scales."""
        m0 = self.RI_downCntx(residuals)  # (B, c, H, W)
        m1, _ = self.RI_resBlock1(m0)  # (B, 2c, H/2, W/2)
        m2, _ = self.RI_resBlock2(m1)  # (B, 4c, H/4, W/4)
        m3, _ = self.RI_resBlock3(m2)  # (B, 8c, H/8, W/8)
        m4, _ = self.RI_resBlock4(m3)  # (B, 8c, H/16, W/16)
        return m0, m1, m2, m3, m4

    def encode_context(self, scan: Tensor) -> Tensor:
        """Range image (B, 5, H, W), normalised, to appearance features (B, c, H, W)."""
        x = self.downCntx(scan)  # (B, c, H, W)
        if self.meta_kernel:
            x = self.metaConv(scan, x)  # (B, c, H, W)
        return self.downCntx3(self.downCntx2(x))  # (B, c, H, W)

    def attend(self, level: str, appearance: Tensor, motion: Tensor) -> Tensor:
        """Motion-guided attention at one scale, (B, C, H', W') each."""
        spatial = getattr(self, f"conv1x1_{level}_spatial")
        channel_wise = getattr(self, f"conv1x1_{level}_channel_wise")
        return motion_guided_attention(appearance, motion, spatial, channel_wise)


def build_image_network(config: ModelConfig) -> nn.Module:
    """The image network: forward(image (B, 5 + L, H, W)) -> ImageOutput."""
    if config.network == "lmnet":
        return LMNet(config)
    if config.network == "dual":
        return DualBranchNet(config)
    from mos_model.networks.realtime import RealtimeNet

    return RealtimeNet(config)


def build_point_head(config: ModelConfig) -> nn.Module | None:
    """The point head: forward(grid, features (N, c)) -> logits (N, 3); None where there is none."""
    if config.point_head is None:
        return None
    from mos_model.networks.point_head import PointHead

    return PointHead(config.point_head)

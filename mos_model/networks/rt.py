"""The small network for real time: the paper's design, built from what a CPU does fast.

Two branches, motion-guided attention at every scale and an image head, as in the paper (Sec. III-B). What differs:
convolution -> BatchNorm -> ReLU, so that BatchNorm folds into the convolution; strided convolutions instead of
pooling; the first one halves the width, and the logits of two neighbouring columns come from one feature; nearest
neighbours on the way up; skips are added, not concatenated; the channel gate is a sigmoid; residuals are clipped.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from mos_model.networks.config import ModelConfig
from mos_model.networks.image_output import ImageOutput
from runtime.bundle.head_shape import SMALL
from runtime.bundle.residual import Residual
from runtime.bundle.view import SCAN_CHANNELS
from runtime.classes import CLASSES
from runtime.errors import SettingError

CLIP = 1.0  # residuals beyond +-CLIP say no more than CLIP


@dataclass(frozen=True)
class RealtimeConfig(ModelConfig):
    """The network of the default bundle."""

    kind: ClassVar[str] = "rt"
    named: ClassVar[Mapping[str, Mapping[str, Any]]] = {"rt": {}, "rt-head": {"point_head": SMALL}}
    channels_last: ClassVar[bool] = True  # by a sixth

    name: str = "rt"
    residual: Residual = field(default_factory=lambda: Residual(kind="signed"))
    widths: tuple[int, ...] = (16, 32, 64, 128)  # channels of the stages: at 1/1, 1/2, 1/4 and 1/8 of the height

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.widths or min(self.widths) < 1:
            raise SettingError(f"widths must be the channels of at least one stage, not {self.widths!r}")

    def build_image_network(self) -> nn.Module:
        """See `ModelConfig`."""
        return RealtimeNet(self)


def conv(i: int, o: int, kernel: int | tuple[int, int] = 3, stride: int | tuple[int, int] = 1) -> nn.Sequential:
    """Convolution, BatchNorm, ReLU."""
    size = (kernel, kernel) if isinstance(kernel, int) else kernel
    padding = (size[0] // 2, size[1] // 2)
    return nn.Sequential(nn.Conv2d(i, o, size, stride, padding, bias=False), nn.BatchNorm2d(o), nn.ReLU(inplace=True))


class Residual3x3(nn.Module):
    """Two 3x3 convolutions around an identity shortcut."""

    def __init__(self, c: int) -> None:
        super().__init__()
        self.conv1 = conv(c, c)
        self.conv2 = nn.Conv2d(c, c, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(c)

    def forward(self, x: Tensor) -> Tensor:
        a: Tensor = self.bn2(self.conv2(self.conv1(x)))  # (B, c, H, W)
        return torch.relu(x + a)  # (B, c, H, W)


class Attention(nn.Module):
    """Motion-guided attention (paper, eq. 3 and 4) with a sigmoid for the channels."""

    def __init__(self, c: int) -> None:
        super().__init__()
        self.spatial = nn.Conv2d(c, 1, 1)
        self.channel_wise = nn.Conv2d(c, c, 1)

    def forward(self, a: Tensor, m: Tensor) -> Tensor:
        g = torch.sigmoid(self.spatial(m)) * a  # (B, c, H, W)
        k = torch.sigmoid(self.channel_wise(g.mean((2, 3), keepdim=True)))  # (B, c, 1, 1)
        return g * k + a + m  # (B, c, H, W); the motion itself joins, for there is little depth to carry it


class Up(nn.Module):
    """Twice the resolution, joined with the skip."""

    def __init__(self, i: int, o: int) -> None:
        super().__init__()
        self.reduce = nn.Conv2d(i, o, 1)
        self.conv = conv(o, o)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        up = nn.functional.interpolate(self.reduce(x), scale_factor=2.0, mode="nearest")  # (B, o, 2H, 2W)
        joined: Tensor = self.conv(torch.relu(up + skip))  # (B, o, 2H, 2W)
        return joined


class RealtimeNet(nn.Module):
    """Image network of configuration "rt"."""

    def __init__(self, config: RealtimeConfig) -> None:
        super().__init__()
        widths = config.widths
        first, features = widths[0], config.channels
        self.range_stem = conv(SCAN_CHANNELS, first, (3, 5), (1, 2))
        self.range_refine = conv(first, first)
        self.motion_stem = conv(len(config.residual.lags), first, (3, 5), (1, 2))
        pairs = list(pairwise(widths))
        self.range_down = nn.ModuleList(conv(i, o, 3, 2) for i, o in pairs)
        self.range_blocks = nn.ModuleList(Residual3x3(o) for _, o in pairs)
        self.motion_down = nn.ModuleList(conv(i, o, 3, 2) for i, o in pairs)
        self.motion_blocks = nn.ModuleList(conv(o, o) for _, o in pairs)
        self.attention = nn.ModuleList(Attention(c) for c in widths)
        self.middle = Residual3x3(widths[-1])
        self.up = nn.ModuleList(Up(o, i) for i, o in reversed(pairs))
        self.features = nn.Conv2d(first, features, 1)
        self.logits = nn.Conv2d(features, 2 * len(CLASSES), 1)

    def forward(self, image: Tensor) -> ImageOutput:
        """image (B, 5 + L, H, W) float32, H and W multiples of 16."""
        x = torch.relu(self.features(self.decode(image)))  # (B, f, H, W/2)
        pairs = self.logits(x)  # (B, 6, H, W/2): each class at the even and at the odd column
        batch, _, height, width = pairs.shape
        pairs = pairs.view(batch, len(CLASSES), 2, height, width).permute(0, 1, 3, 4, 2)  # (B, 3, H, W/2, 2)
        return ImageOutput(pairs.reshape(batch, len(CLASSES), height, 2 * width), x)

    def decode(self, image: Tensor) -> Tensor:
        """From the image to the decoder's last map (B, w0, H, W/2)."""
        a = self.range_refine(self.range_stem(image[:, :SCAN_CHANNELS]))  # (B, w0, H, W/2)
        m = self.motion_stem(image[:, SCAN_CHANNELS:].clamp(-CLIP, CLIP))  # (B, w0, H, W/2)
        a = self.attention[0](a, m)
        skips = [a]
        stages = zip(
            self.range_down,
            self.range_blocks,
            self.motion_down,
            self.motion_blocks,
            self.attention[1:],
            strict=True,
        )
        for range_down, range_block, motion_down, motion_block, attention in stages:
            m = motion_block(motion_down(m))  # (B, w, H/2, W/4), then 1/4, 1/8 of the height
            a = attention(range_block(range_down(a)), m)  # the same shape
            skips.append(a)
        x: Tensor = self.middle(skips.pop())  # (B, w3, H/8, W/16)
        for up, skip in zip(self.up, reversed(skips), strict=True):
            x = up(x, skip)  # ... (B, w0, H, W/2)
        return x

"""LiMoSeg (Mohapatra et al., arXiv 2111.04875): two scans from above, an encoder for each, one decoder for both.

There is no public code. By its paper: two successive scans, the earlier one moved to where the later was taken; 2D
bird's-eye-view images of both; features of each by an encoder of its own; a joint decoder; static or moving for every
cell, in real time on an embedded platform. What that leaves open is chosen here:

- the view (`BirdView`): a square of 102.4 m around the sensor at 0.2 m a cell, z from -5 m to 3 m; all around and not
  ahead only, since every point is to get a label; points outside of it are static;
- channels (`runtime.image.bird_inputs`): highest and lowest z, density, occupancy; of the current scan remission too;
- encoders of one structure with weights of their own: four stages, each at half the resolution of the one before, a
  strided convolution and from the second stage on two convolutions around a shortcut; convolution, BatchNorm, ReLU;
- both scans meet at every stage, by a 1x1 convolution over their features side by side;
- the decoder climbs by nearest neighbours, adds the joined features, and one 3x3 convolution follows; the scores of
  four cells come from one feature of the finest stage;
- widths: what 60 ms a scan on two cores of a CPU allow;
- points take the scores of their cell. Loss and training are those of the other networks, without the augmentation of
  the paper, which cuts and pastes parked cars: simulated streets have movers enough.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from mos_model.networks.config import ModelConfig
from mos_model.networks.image_output import ImageOutput
from mos_model.networks.rt import Residual3x3, Up, conv
from runtime.bundle.residual import Residual
from runtime.bundle.view import PAST_CHANNELS, SCAN_CHANNELS, BirdView, View
from runtime.classes import CLASSES
from runtime.errors import SettingError


@dataclass(frozen=True)
class LiMoSegConfig(ModelConfig):
    """The bird's-eye view of the paper's Table I."""

    kind: ClassVar[str] = "limoseg"
    named: ClassVar[Mapping[str, Mapping[str, Any]]] = {"limoseg": {}}
    channels_last: ClassVar[bool] = True

    name: str = "limoseg"
    residual: Residual = field(default_factory=lambda: Residual(lags=(1,)))  # an encoder for each lag
    bird: BirdView = field(default_factory=BirdView)
    widths: tuple[int, ...] = (16, 16, 32, 64)  # channels of the stages: at 1/2, 1/4, 1/8 and 1/16 of the view

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= len(self.widths) <= 4 or min(self.widths) < 1:
            raise SettingError(f"widths must be the channels of one to four stages, not {self.widths!r}")

    def build_image_network(self) -> nn.Module:
        """See `ModelConfig`."""
        return LiMoSeg(self)

    @property
    def view(self) -> View:
        """See `ModelConfig`."""
        return View(self.range_image, self.residual, self.bird)


class Encoder(nn.Module):
    """Features of one scan at every stage."""

    def __init__(self, channels: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.stem = conv(channels, widths[0], 3, 2)
        self.down = nn.ModuleList(conv(i, o, 3, 2) for i, o in pairwise(widths))
        self.blocks = nn.ModuleList(Residual3x3(o) for o in widths[1:])

    def forward(self, x: Tensor) -> list[Tensor]:
        """(B, channels, H, W) to (B, w0, H/2, W/2), (B, w1, H/4, W/4), ..."""
        maps = [self.stem(x)]
        for down, block in zip(self.down, self.blocks, strict=True):
            maps.append(block(down(maps[-1])))
        return maps


class LiMoSeg(nn.Module):
    """Image network of configuration "limoseg"."""

    def __init__(self, config: LiMoSegConfig) -> None:
        super().__init__()
        widths, past = config.widths, len(config.residual.lags)
        self.encoders = nn.ModuleList(Encoder(i, widths) for i in (SCAN_CHANNELS, *past * (PAST_CHANNELS,)))
        self.join = nn.ModuleList(conv((1 + past) * width, width, 1) for width in widths)
        self.middle = Residual3x3(widths[-1])
        self.up = nn.ModuleList(Up(o, i) for i, o in reversed(list(pairwise(widths))))
        self.features = nn.Conv2d(widths[0], config.channels, 1)
        self.logits = nn.Conv2d(config.channels, 4 * len(CLASSES), 1)

    def forward(self, image: Tensor) -> ImageOutput:
        """image (B, 5 + 4 L, H, W) float32, H and W multiples of 16."""
        maps = [self.encoders[0](image[:, :SCAN_CHANNELS])]
        for number, encoder in enumerate(self.encoders[1:]):
            first = SCAN_CHANNELS + number * PAST_CHANNELS
            maps.append(encoder(image[:, first : first + PAST_CHANNELS]))
        skips = [join(torch.cat(stage, 1)) for join, stage in zip(self.join, zip(*maps, strict=True), strict=True)]
        x: Tensor = self.middle(skips.pop())  # (B, w3, H/16, W/16)
        for up, skip in zip(self.up, reversed(skips), strict=True):
            x = up(x, skip)  # ... (B, w0, H/2, W/2)
        x = torch.relu(self.features(x))  # (B, c, H/2, W/2)
        logits = F.pixel_shuffle(self.logits(x), 2)  # (B, 3, H, W)
        return ImageOutput(logits, F.interpolate(x, scale_factor=(2.0, 1.0), mode="nearest"))  # (B, c, H, W/2)

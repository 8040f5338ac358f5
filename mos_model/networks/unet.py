"""What the networks of the paper share: the way down and up through the resolutions (SalsaNext)."""

from dataclasses import dataclass

from torch import Tensor, nn

from mos_model.networks.blocks import POOLINGS, ContextBlock, ResBlock, UpBlock
from mos_model.networks.config import ModelConfig
from runtime.errors import SettingError


@dataclass(frozen=True)
class UNetConfig(ModelConfig):
    """A network of the paper."""

    pooling: str = "soft"  # "soft": SoftPool; "average": 3x3 average, stride 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pooling not in POOLINGS:
            raise SettingError(f"pooling must be one of {', '.join(POOLINGS)}, not {self.pooling!r}")


class UNet(nn.Module):
    """Context, encoder, middle and decoder of c channels and more."""

    def __init__(self, in_channels: int, c: int, pool: str) -> None:
        super().__init__()
        self.context = nn.ModuleList([ContextBlock(in_channels, c), ContextBlock(c, c), ContextBlock(c, c)])
        self.encoder = encoder(c, pool)
        self.middle = ResBlock(8 * c, 8 * c, None)
        self.decoder = nn.ModuleList(
            [UpBlock(8 * c, 4 * c), UpBlock(4 * c, 4 * c), UpBlock(4 * c, 2 * c), UpBlock(2 * c, c, dropout=0)]
        )

    def decode(self, x: Tensor, skips: list[Tensor]) -> Tensor:
        """From (B, 8c, H/16, W/16) and the skips at 1/1, 1/2, 1/4, 1/8 to the features (B, c, H, W)."""
        x = self.middle(x)  # (B, 8c, H/16, W/16)
        for up, skip in zip(self.decoder, reversed(skips), strict=True):
            x = up(x, skip)  # (B, 4c, H/8, W/8), (B, 4c, H/4, W/4), (B, 2c, H/2, W/2), (B, c, H, W)
        return x


def encoder(c: int, pool: str) -> nn.ModuleList:
    """Four blocks, each to half the resolution: from c channels to 2c, 4c, 8c and 8c."""
    return nn.ModuleList(
        [
            ResBlock(c, 2 * c, pool, dropout=0),
            ResBlock(2 * c, 4 * c, pool),
            ResBlock(4 * c, 8 * c, pool),
            ResBlock(8 * c, 8 * c, pool),
        ]
    )

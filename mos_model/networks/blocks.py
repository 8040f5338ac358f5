"""Building blocks of the image networks (paper, Sec. III-A to III-C).

Shapes are (batch, channels, height, width).
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional as F

DROPOUT = 0.2


def act(x: Tensor) -> Tensor:
    """The one activation of the image networks."""
    return F.leaky_relu(x, 0.01)


class ConvNorm(nn.Module):
    """Convolution -> LeakyReLU -> BatchNorm, in this order."""

    def __init__(self, conv: nn.Conv2d) -> None:
        super().__init__()
        self.conv = conv
        self.norm = nn.BatchNorm2d(conv.out_channels)

    def forward(self, x: Tensor) -> Tensor:
        x = self.norm(act(self.conv(x)))
        return x


def conv3(i: int, o: int) -> ConvNorm:
    """3x3."""
    return ConvNorm(nn.Conv2d(i, o, 3, padding=1))


def conv3_dilated(i: int, o: int) -> ConvNorm:
    """3x3 over a 5x5 window."""
    return ConvNorm(nn.Conv2d(i, o, 3, padding=2, dilation=2))


def conv2_dilated(i: int, o: int) -> ConvNorm:
    """2x2 over the corners of a 3x3 window."""
    return ConvNorm(nn.Conv2d(i, o, 2, padding=1, dilation=2))


def conv1(i: int, o: int) -> ConvNorm:
    """1x1."""
    return ConvNorm(nn.Conv2d(i, o, 1))


class SoftPool(nn.Module):
    """2x2 pooling, stride 2, each pixel weighted by the softmax over its window (paper, Sec. III-C).

    The window's maximum is subtracted before exp and the weights are normalised before they meet the values:
    nothing overflows, in half precision neither. Slices instead of `unfold`: fast in every ONNX provider.
    """

    def forward(self, x: Tensor) -> Tensor:
        a, b, c, d = (x[..., i::2, j::2] for i in (0, 1) for j in (0, 1))  # 4 x (B, C, H/2, W/2)
        top = torch.maximum(torch.maximum(a, b), torch.maximum(c, d)).detach()  # (B, C, H/2, W/2)
        ea, eb, ec, ed = ((v - top).exp() for v in (a, b, c, d))  # 0..1, one of them 1
        scale = 1 / (ea + eb + ec + ed)  # (B, C, H/2, W/2) 1/4..1
        return a * (ea * scale) + b * (eb * scale) + c * (ec * scale) + d * (ed * scale)  # (B, C, H/2, W/2)


POOLINGS: dict[str, Callable[[], nn.Module]] = {  # halve the image
    "average": lambda: nn.AvgPool2d(3, stride=2, padding=1),  # of LMNet; the padding counts as zeros
    "soft": SoftPool,
}


class ContextBlock(nn.Module):
    """Two stacked 3x3 convolutions, the second dilated, around a 1x1 shortcut; keeps the resolution."""

    def __init__(self, i: int, o: int) -> None:
        super().__init__()
        self.shortcut = nn.Conv2d(i, o, 1)
        self.first = conv3(o, o)
        self.second = conv3_dilated(o, o)

    def forward(self, x: Tensor) -> Tensor:
        shortcut = act(self.shortcut(x))  # (B, o, H, W)
        a = self.first(shortcut)  # (B, o, H, W)
        b: Tensor = self.second(a)  # (B, o, H, W)
        return shortcut + b  # (B, o, H, W)


class ResBlock(nn.Module):
    """Three convolutions of growing reach, joined by a 1x1 and added to a 1x1 shortcut.

    With `pool` (of POOLINGS) forward returns the halved image and, as the skip, the full one before dropout;
    without, it returns the image alone.
    """

    def __init__(self, i: int, o: int, pool: str | None, dropout: float = DROPOUT) -> None:
        super().__init__()
        self.shortcut = nn.Conv2d(i, o, 1)
        self.first = conv3(i, o)
        self.second = conv3_dilated(o, o)
        self.third = conv2_dilated(o, o)
        self.join = conv1(3 * o, o)
        self.dropout = nn.Dropout2d(dropout)
        self.pool = None if pool is None else POOLINGS[pool]()

    def forward(self, x: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        shortcut = act(self.shortcut(x))  # (B, o, H, W)
        a = self.first(x)  # (B, o, H, W)
        b = self.second(a)  # (B, o, H, W)
        c = self.third(b)  # (B, o, H, W)
        result = shortcut + self.join(torch.cat((a, b, c), 1))  # (B, o, H, W)
        kept: Tensor = self.dropout(result)  # (B, o, H, W)
        return kept if self.pool is None else (self.pool(kept), result)  # (B, o, H/2, W/2), (B, o, H, W)


class UpBlock(nn.Module):
    """Pixel shuffle to twice the resolution, joined with the encoder's skip of 2o channels."""

    def __init__(self, i: int, o: int, dropout: float = DROPOUT) -> None:
        super().__init__()
        self.first = conv3(i // 4 + 2 * o, o)
        self.second = conv3_dilated(o, o)
        self.third = conv2_dilated(o, o)
        self.join = conv1(3 * o, o)
        self.dropout = nn.Dropout2d(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        up = self.dropout(F.pixel_shuffle(x, 2))  # (B, i/4, 2H, 2W)
        both = self.dropout(torch.cat((up, skip), 1))  # (B, i/4 + 2o, 2H, 2W)
        a = self.first(both)  # (B, o, 2H, 2W)
        b = self.second(a)  # (B, o, 2H, 2W)
        c = self.third(b)  # (B, o, 2H, 2W)
        result: Tensor = self.dropout(self.join(torch.cat((a, b, c), 1)))  # (B, o, 2H, 2W)
        return result


class MetaKernel(nn.Module):
    """A 3x3 convolution whose weights depend on the relative geometry of the window (paper, Sec. III-A).

    For the nine neighbours j: weight w_j = weigh2(act(weigh1(input_j - input_center))), product w_j * f_j, and
    `join` over the 9c products (channel index = channel * 9 + j). Two rearrangements keep the memory
    traffic low: weigh1 is linear, so it runs once and its result is shifted; and `join` is a sum of nine
    c -> c convolutions. Outside the image coordinates and features are zero.
    """

    def __init__(self, c: int, hidden: int = 16) -> None:
        super().__init__()
        self.weigh1 = nn.Conv2d(5, hidden, 1)
        self.weigh2 = nn.Conv2d(hidden, c, 1)
        self.join = nn.Conv2d(9 * c, c, 1)

    def forward(self, x: Tensor, features: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        assert self.weigh1.bias is not None
        assert self.join.bias is not None
        center = F.conv2d(x, self.weigh1.weight)  # (B, 16, H, W)
        near = F.pad(center, (1, 1, 1, 1))  # (B, 16, H+2, W+2)
        center = center - self.weigh1.bias[:, None, None]  # so that near - center carries the bias
        features = F.pad(features, (1, 1, 1, 1))  # (B, c, H+2, W+2)
        out = self.join.bias[:, None, None]  # (c, 1, 1)
        for j in range(9):
            window = (..., slice(j // 3, j // 3 + height), slice(j % 3, j % 3 + width))
            weight = self.weigh2(act(near[window] - center))  # (B, c, H, W)
            product = weight * features[window]  # (B, c, H, W)
            out = out + F.conv2d(product, self.join.weight[:, j::9])  # (B, c, H, W)
        return out


class MotionGuidedAttention(nn.Module):
    """Motion features `m` choose where and in which channels appearance `a` counts (paper, eq. 3 and 4)."""

    def __init__(self, c: int) -> None:
        super().__init__()
        self.spatial = nn.Conv2d(c, 1, 1)
        self.channel_wise = nn.Conv2d(c, c, 1)

    def forward(self, a: Tensor, m: Tensor) -> Tensor:
        g = torch.sigmoid(self.spatial(m)) * a  # (B, c, H, W)
        k: Tensor = self.channel_wise(g.mean((2, 3), keepdim=True))  # (B, c, 1, 1)
        k = k.softmax(1) * a.shape[1]  # (B, c, 1, 1), 1 on average
        return g * k + a  # (B, c, H, W)

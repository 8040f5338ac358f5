"""Building blocks of the image networks (paper, Sec. III-A to III-C).

Every block computes conv -> LeakyReLU -> BatchNorm, in this order. Shapes are (batch, channels, height,
width); the names of attributes are those of the published checkpoints.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

DROPOUT = 0.2


def act(x: Tensor) -> Tensor:
    """The one activation of the image networks."""
    return F.leaky_relu(x, 0.01)


def conv3(i: int, o: int) -> nn.Conv2d:
    """3x3."""
    return nn.Conv2d(i, o, 3, padding=1)


def conv3_dilated(i: int, o: int) -> nn.Conv2d:
    """3x3 over a 5x5 window."""
    return nn.Conv2d(i, o, 3, padding=2, dilation=2)


def conv2_dilated(i: int, o: int) -> nn.Conv2d:
    """2x2 over the corners of a 3x3 window."""
    return nn.Conv2d(i, o, 2, padding=1, dilation=2)


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


def pooling(kind: str) -> nn.Module:
    """Halve the image: "soft", or the 3x3 "average" of LMNet (padding counts as zeros)."""
    return SoftPool() if kind == "soft" else nn.AvgPool2d(3, stride=2, padding=1)


class ContextBlock(nn.Module):
    """Two stacked 3x3 convolutions, the second dilated, around a 1x1 shortcut; keeps the resolution."""

    def __init__(self, i: int, o: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(i, o, 1)
        self.conv2 = conv3(o, o)
        self.bn1 = nn.BatchNorm2d(o)
        self.conv3 = conv3_dilated(o, o)
        self.bn2 = nn.BatchNorm2d(o)

    def forward(self, x: Tensor) -> Tensor:
        shortcut = act(self.conv1(x))  # (B, o, H, W)
        a = self.bn1(act(self.conv2(shortcut)))  # (B, o, H, W)
        b = self.bn2(act(self.conv3(a)))  # (B, o, H, W)
        return shortcut + b  # (B, o, H, W)


class ResBlock(nn.Module):
    """Three convolutions of growing reach, joined by a 1x1 and added to a 1x1 shortcut.

    With `pool` ("soft" or "average") forward returns the halved image and, as the skip, the full one before
    dropout; without, it returns the image alone.
    """

    def __init__(self, i: int, o: int, pool: str | None, dropout: float = DROPOUT) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(i, o, 1)
        self.conv2 = conv3(i, o)
        self.bn1 = nn.BatchNorm2d(o)
        self.conv3 = conv3_dilated(o, o)
        self.bn2 = nn.BatchNorm2d(o)
        self.conv4 = conv2_dilated(o, o)
        self.bn3 = nn.BatchNorm2d(o)
        self.conv5 = nn.Conv2d(3 * o, o, 1)
        self.bn4 = nn.BatchNorm2d(o)
        self.dropout = nn.Dropout2d(dropout)
        self.pool = None if pool is None else pooling(pool)

    def forward(self, x: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        shortcut = act(self.conv1(x))  # (B, o, H, W)
        a = self.bn1(act(self.conv2(x)))  # (B, o, H, W)
        b = self.bn2(act(self.conv3(a)))  # (B, o, H, W)
        c = self.bn3(act(self.conv4(b)))  # (B, o, H, W)
        joined = self.bn4(act(self.conv5(torch.cat((a, b, c), 1))))  # (B, o, H, W)
        result = shortcut + joined  # (B, o, H, W)
        if self.pool is None:
            return self.dropout(result)  # (B, o, H, W)
        return self.pool(self.dropout(result)), result  # (B, o, H/2, W/2), (B, o, H, W)


class UpBlock(nn.Module):
    """Pixel shuffle to twice the resolution, joined with the encoder's skip of 2o channels."""

    def __init__(self, i: int, o: int, dropout: float = DROPOUT) -> None:
        super().__init__()
        self.conv1 = conv3(i // 4 + 2 * o, o)
        self.bn1 = nn.BatchNorm2d(o)
        self.conv2 = conv3_dilated(o, o)
        self.bn2 = nn.BatchNorm2d(o)
        self.conv3 = conv2_dilated(o, o)
        self.bn3 = nn.BatchNorm2d(o)
        self.conv4 = nn.Conv2d(3 * o, o, 1)
        self.bn4 = nn.BatchNorm2d(o)
        self.dropout = nn.Dropout2d(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        up = self.dropout(F.pixel_shuffle(x, 2))  # (B, i/4, 2H, 2W)
        both = self.dropout(torch.cat((up, skip), 1))  # (B, i/4 + 2o, 2H, 2W)
        a = self.bn1(act(self.conv1(both)))  # (B, o, 2H, 2W)
        b = self.bn2(act(self.conv2(a)))  # (B, o, 2H, 2W)
        c = self.bn3(act(self.conv3(b)))  # (B, o, 2H, 2W)
        joined = self.bn4(act(self.conv4(torch.cat((a, b, c), 1))))  # (B, o, 2H, 2W)
        return self.dropout(joined)  # (B, o, 2H, 2W)


class MetaKernel(nn.Module):
    """A 3x3 convolution whose weights depend on the relative geometry of the window (paper, Sec. III-A).

    For the nine neighbours j: weight w_j = conv2(act(conv1(input_j - input_center))), product w_j * f_j, and
    `conv1x1` over the 9c products (channel index = channel * 9 + j). Two rearrangements keep the memory
    traffic low: conv1 is linear, so it runs once and its result is shifted; and `conv1x1` is a sum of nine
    c -> c convolutions. Outside the image coordinates and features are zero.
    """

    def __init__(self, c: int, hidden: int = 16) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(5, hidden, 1)
        self.conv2 = nn.Conv2d(hidden, c, 1)
        self.conv1x1 = nn.Conv2d(9 * c, c, 1)

    def forward(self, x: Tensor, features: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        center = F.conv2d(x, self.conv1.weight)  # (B, 16, H, W)
        near = F.pad(center, (1, 1, 1, 1))  # (B, 16, H+2, W+2)
        center = center - self.conv1.bias[:, None, None]  # so that near - center carries the bias
        features = F.pad(features, (1, 1, 1, 1))  # (B, c, H+2, W+2)
        out = self.conv1x1.bias[:, None, None]  # (c, 1, 1)
        for j in range(9):
            window = (..., slice(j // 3, j // 3 + height), slice(j % 3, j % 3 + width))
            weight = self.conv2(act(near[window] - center))  # (B, c, H, W)
            product = weight * features[window]  # (B, c, H, W)
            out = out + F.conv2d(product, self.conv1x1.weight[:, j::9])  # (B, c, H, W)
        return out


def motion_guided_attention(a: Tensor, m: Tensor, spatial: nn.Conv2d, channel_wise: nn.Conv2d) -> Tensor:
    """Motion features `m` choose where and in which channels appearance `a` counts (paper, eq. 3 and 4)."""
    g = torch.sigmoid(spatial(m)) * a  # (B, C, H, W)
    k = channel_wise(g.mean((2, 3), keepdim=True))  # (B, C, 1, 1)
    k = k.softmax(1) * a.shape[1]  # (B, C, 1, 1), 1 on average
    return g * k + a  # (B, C, H, W)

"""Two blocks of the network in a form that ONNX Runtime computes without leaving its blocked memory layout.

ONNX Runtime's fast convolutions keep 8 or 16 channels of a pixel together. Slices know only the plain layout, so each
costs a pass over the map to reorder it, there and back. A convolution that copies one pixel of its window does the
same as a slice, in the blocked layout. The values are those of `mos_model.networks.blocks`, to the last bit but for the
order of sums.
"""

import copy
from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from mos_model.networks.blocks import MetaKernel, SoftPool, act

CENTRE = 4  # of the nine pixels of a 3x3 window, row by row
NEIGHBOURS = (0, 1, 2, 3, 5, 6, 7, 8)


def with_blocked_forms(network: nn.Module) -> nn.Module:
    """A copy of `network` with each SoftPool and MetaKernel in its form for ONNX Runtime."""
    return with_forms(network, BlockedSoftPool, BlockedMetaKernel)


def with_forms(
    network: nn.Module, soft_pool: Callable[[], nn.Module], meta_kernel: Callable[[MetaKernel], nn.Module]
) -> nn.Module:
    """A copy of `network` with each SoftPool and MetaKernel in another form."""
    network = copy.deepcopy(network)
    for module in list(network.modules()):
        for name, child in module.named_children():
            if isinstance(child, SoftPool):
                setattr(module, name, soft_pool())
            elif isinstance(child, MetaKernel):
                setattr(module, name, meta_kernel(child))
    return network


def copies(size: int) -> Tensor:
    """(size * size, 1, 1, size, size): kernel j copies pixel j (row-major) of a window."""
    return torch.eye(size * size).view(size * size, 1, 1, size, size)


class BlockedSoftPool(nn.Module):
    """SoftPool (paper, Sec. III-C); the window's pixels come from four copying convolutions."""

    copy: Tensor  # (4, 1, 1, 2, 2)

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("copy", copies(2))

    def forward(self, x: Tensor) -> Tensor:
        count = x.shape[1]
        kernels = [kernel.expand(count, 1, 2, 2) for kernel in self.copy]
        pixels = [F.conv2d(x, kernel, stride=2, groups=count) for kernel in kernels]
        a, b, c, d = pixels  # 4 x (B, C, H/2, W/2)
        top = torch.maximum(torch.maximum(a, b), torch.maximum(c, d))
        ea, eb, ec, ed = ((pixel - top).exp() for pixel in pixels)  # 0..1, one of them 1: no overflow
        return (a * ea + b * eb + c * ec + d * ed) / (ea + eb + ec + ed)


class BlockedMetaKernel(nn.Module):
    """MetaKernel (paper, Sec. III-A); weigh1 of (neighbour - centre) is one 3x3 convolution with two taps.

    The centre differs from itself by nothing, so its weights are the same for every pixel: with those of `join` they
    make one convolution.
    """

    copy: Tensor  # (9, 1, 1, 3, 3)
    near: Tensor  # (9, 16, 5, 3, 3)
    centre: Tensor  # (c, c, 1, 1)

    def __init__(self, block: MetaKernel) -> None:
        super().__init__()
        assert block.weigh1.bias is not None
        self.bias, self.weigh2, self.join = block.weigh1.bias, block.weigh2, block.join
        self.register_buffer("copy", copies(3))
        difference = self.copy - self.copy[CENTRE]  # (9, 1, 1, 3, 3)
        self.register_buffer("near", block.weigh1.weight.detach() * difference)
        with torch.no_grad():
            same = self.weigh2(act(block.weigh1.bias)[None, :, None, None])  # (1, c, 1, 1)
            self.register_buffer("centre", self.join.weight[:, CENTRE::9] * same)

    def weight(self, x: Tensor, j: int) -> Tensor:
        """(B, c, H, W): weights of neighbour j from the coordinates (B, 5, H, W)."""
        weights: Tensor = self.weigh2(act(F.conv2d(x, self.near[j], self.bias, padding=1)))
        return weights

    def forward(self, x: Tensor, features: Tensor) -> Tensor:
        c = features.shape[1]
        out = F.conv2d(features, self.centre, self.join.bias)  # (B, c, H, W)
        for j in NEIGHBOURS:
            neighbour = F.conv2d(features, self.copy[j].expand(c, 1, 3, 3), padding=1, groups=c)
            out = out + F.conv2d(self.weight(x, j) * neighbour, self.join.weight[:, j::9])  # (B, c, H, W)
        return out

"""Two blocks of the network in the form that suits an integer graph, whose convolutions keep channels last.

SoftPool stays one node until the graph is quantised: what it needs of exponents then depends on the integers.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from export.graph.blocked_forms import NEIGHBOURS, BlockedMetaKernel, with_forms
from export.graph.emitters import emits
from export.graph.graph import Graph
from export.graph.tracing import Tracer
from mos_model.networks.blocks import MetaKernel, SoftPool

LARGEST_EXPONENT = 80.0  # exp(-80) is still a normal float32


@torch.library.custom_op("lidar_mos::soft_pool", mutates_args=())
def soft_pool(x: Tensor) -> Tensor:
    """`mos_model.networks.blocks.SoftPool` as one operation, for the tracer."""
    pooled: Tensor = SoftPool()(x)
    return pooled


@soft_pool.register_fake
def _(x: Tensor) -> Tensor:
    batch, channels, height, width = x.shape
    return x.new_empty((batch, channels, height // 2, width // 2))


@emits("lidar_mos.soft_pool")
def _soft_pool(t: Tracer, shape: tuple[int, ...], x: Tensor) -> str:
    return t.graph.add("SoftPool", [t.name(x)], shape)


class IntegerSoftPool(nn.Module):
    """SoftPool (paper, Sec. III-C) as one node."""

    def forward(self, x: Tensor) -> Tensor:
        pooled: Tensor = soft_pool(x)
        return pooled


class IntegerMetaKernel(BlockedMetaKernel):
    """MetaKernel (paper, Sec. III-A): products side by side, four at a time, so that a convolution sums them up."""

    joined: Tensor  # (2, c, 4c, 1, 1)

    def __init__(self, block: MetaKernel) -> None:
        super().__init__(block)
        weight = block.join.weight.detach()  # (c, 9c, 1, 1), input channel = channel * 9 + j
        self.halves = (NEIGHBOURS[:4], NEIGHBOURS[4:])  # eight products side by side would not fit the cache
        kernels = [torch.cat([weight[:, j::9] for j in half], 1) for half in self.halves]
        self.register_buffer("joined", torch.stack(kernels))

    def forward(self, x: Tensor, features: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        around = F.pad(features, (1, 1, 1, 1))  # (B, c, H+2, W+2)
        out = F.conv2d(features, self.centre, self.join.bias)  # (B, c, H, W)
        for kernel, half in zip(self.joined, self.halves, strict=True):
            near = [around[..., j // 3 : j // 3 + height, j % 3 : j % 3 + width] for j in half]
            products = [self.weight(x, j) * part for j, part in zip(half, near, strict=True)]
            out = out + F.conv2d(torch.cat(products, 1), kernel)  # (B, c, H, W)
        return out


def with_integer_forms(network: nn.Module) -> nn.Module:
    """A copy of `network` with each SoftPool and MetaKernel in its form for an integer graph."""
    return with_forms(network, IntegerSoftPool, IntegerMetaKernel)


def expand_soft_pool(
    graph: Graph, x: str, shape: tuple[int, ...], real: Callable[[str], str], span: float, offset: np.ndarray
) -> str:
    """Append SoftPool of `x` (1, C, H, W) and return its sum with `offset` (C,).

    real: appends what turns a part of x into real numbers, all within -span..0.

    A softmax does not change when a number is added to all values, and the mean that it weighs shifts by that number:
    so no maximum of each window is needed, one of the whole map does. Left and right columns are told apart first,
    as integers; then they are added; then pairs of rows are, all with the channels last.
    """
    _, c, h, w = shape
    x = graph.add("Transpose", [x], (1, h, w, c), perm=[0, 2, 3, 1])
    x = graph.reshape(x, (h * w // 2, 2, c))
    sums: list[str] = []
    for side in (0, 1):
        part = graph.slice(x, (h * w // 2, 1, c), 1, side, side + 1)
        value = graph.reshape(real(part), (h // 2, 2, w // 2 * c))
        limited = value
        if span > LARGEST_EXPONENT:
            low = graph.weight("limit", np.asarray([-LARGEST_EXPONENT]))
            limited = graph.add("Max", [value, low], graph.shapes[value])
        e = graph.add("Exp", [limited], graph.shapes[value])
        both = [graph.add("Mul", [value, e], graph.shapes[value]), e]
        sums = [graph.add("Add", [s, t], graph.shapes[e]) for s, t in zip(sums, both, strict=True)] if sums else both
    rows = (h // 2, w // 2 * c)
    axes = [graph.integers(1) for _ in sums]
    totals = [graph.add("ReduceSum", [s, axis], rows, keepdims=0) for s, axis in zip(sums, axes, strict=True)]
    quotient = graph.reshape(graph.add("Div", totals, rows), (1, h // 2, w // 2, c))
    if offset.any():
        row = (1, 1, w // 2, c)
        shift = graph.add("Expand", [graph.weight("shift", offset.reshape(1, 1, 1, c)), graph.integers(*row)], row)
        quotient = graph.add("Add", [quotient, shift], (1, h // 2, w // 2, c))
    return graph.add("Transpose", [quotient], (1, c, h // 2, w // 2), perm=[0, 3, 1, 2])

"""Sparse convolution and the transfers between voxels and points, with gradients, in plain PyTorch.

Features are rows: (V, channels) of the voxels of one level of a `VoxelGrid`.
"""

from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from mos_model.networks.voxels import Corners, KernelMap


class _SparseConvolution(torch.autograd.Function):
    """Gather, multiply, scatter, one offset at a time; keeps only its input for the way back."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, kernel: Tensor, pairs: KernelMap) -> Tensor:
        ctx.save_for_backward(x, kernel)
        ctx.pairs = pairs
        out = x.new_zeros(pairs.outputs, kernel.shape[2])  # (V', out)
        for weight, source, target in zip(kernel, pairs.source, pairs.target, strict=True):
            _add_rows(out, target, _rows(x, source) @ weight)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, None]:
        x, kernel = ctx.saved_tensors
        grad_x, grad_kernel = torch.zeros_like(x), torch.zeros_like(kernel)
        for k, (source, target) in enumerate(zip(ctx.pairs.source, ctx.pairs.target, strict=True)):
            g = _rows(grad, target)  # (P_k, out)
            _add_rows(grad_x, source, g @ kernel[k].T)
            grad_kernel[k] = _rows(x, source).T @ g  # (in, out)
        return grad_x, grad_kernel, None


def sparse_convolution(x: Tensor, kernel: Tensor, pairs: KernelMap) -> Tensor:
    """x (V, in), kernel (K, in, out) -> (V', out): out[o] = sum over k of in[o + offset_k] @ kernel[k]."""
    out: Tensor = _SparseConvolution.apply(x, kernel, pairs)  # type: ignore[no-untyped-call]
    return out


class SparseConv(nn.Module):
    """Sparse convolution without bias; `volume` 27 (3x3x3), 8 (2x2x2, down or up) or 1 (a matrix product)."""

    def __init__(self, i: int, o: int, volume: int) -> None:
        super().__init__()
        self.kernel = nn.Parameter(torch.empty((i, o) if volume == 1 else (volume, i, o)))
        nn.init.uniform_(self.kernel, -((volume * i) ** -0.5), (volume * i) ** -0.5)

    def forward(self, x: Tensor, pairs: KernelMap | None = None) -> Tensor:
        """(V, i) -> (V', o)."""
        return x @ self.kernel if pairs is None else sparse_convolution(x, self.kernel, pairs)


def voxels_to_points(x: Tensor, corners: Corners) -> Tensor:
    """Interpolate voxel features (V, c) at points: (P, c)."""
    weight = corners.weight.to(x.dtype)  # (P, 8)
    out = x.new_zeros(len(weight), x.shape[1])  # (P, c)
    for d in range(8):
        out = out + weight[:, d, None] * x.index_select(0, corners.row[:, d])
    return out


def points_to_voxels(z: Tensor, row: Tensor, voxels: int) -> Tensor:
    """Mean of point features (P, c) over each voxel's points: (V, c); `row` (P,) is each point's voxel."""
    total = z.new_zeros(voxels, z.shape[1]).index_add(0, row, z)  # (V, c)
    return total / row.bincount(minlength=voxels)[:, None]


def _rows(x: Tensor, index: Tensor | None) -> Tensor:
    return x if index is None else x.index_select(0, index)


def _add_rows(x: Tensor, index: Tensor | None, rows: Tensor) -> None:
    if index is None:
        x += rows
    else:
        x.index_add_(0, index, rows)

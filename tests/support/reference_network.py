"""Naive references of the network's parts, from the paper: loops and dicts, nothing shared with the code."""

import itertools

import numpy as np
import torch
from torch import Tensor


def soft_pool(x: np.ndarray) -> np.ndarray:
    """2x2 windows of x (..., H, W), stride 2, in float64: sum of x * softmax(x)."""
    x = x.astype(np.float64)
    out = np.empty((*x.shape[:-2], x.shape[-2] // 2, x.shape[-1] // 2))
    for row, column in np.ndindex(out.shape[-2:]):
        window = x[..., 2 * row : 2 * row + 2, 2 * column : 2 * column + 2].reshape(*x.shape[:-2], 4)
        e = np.exp(window - window.max(-1, keepdims=True))
        out[..., row, column] = (window * e).sum(-1) / e.sum(-1)
    return out


def meta_kernel(weights: dict[str, Tensor], x: Tensor, features: Tensor) -> Tensor:
    """One image: x (5, H, W), features (c, H, W) -> (c, H, W), pixel by pixel."""
    matrices = {name: weights[f"{name}.weight"].flatten(1) for name in ("weigh1", "weigh2", "join")}
    c, height, width = features.shape
    out = torch.empty_like(features)
    for row, column in np.ndindex(height, width):
        products = torch.zeros(c, 9, dtype=x.dtype)  # channel-major when flattened
        for j, (dr, dc) in enumerate(itertools.product((-1, 0, 1), repeat=2)):
            r, k = row + dr, column + dc
            inside = 0 <= r < height and 0 <= k < width
            neighbour = x[:, r, k] if inside else torch.zeros_like(x[:, 0, 0])
            hidden = matrices["weigh1"] @ (neighbour - x[:, row, column]) + weights["weigh1.bias"]
            hidden = torch.where(hidden > 0, hidden, 0.01 * hidden)
            weight = matrices["weigh2"] @ hidden + weights["weigh2.bias"]
            products[:, j] = weight * features[:, r, k] if inside else 0
        out[:, row, column] = matrices["join"] @ products.flatten() + weights["join.bias"]
    return out


def attention(a: Tensor, m: Tensor, spatial: Tensor, channel_wise: Tensor, biases: tuple[Tensor, Tensor]) -> Tensor:
    """One image: a, m (C, H, W); spatial (1, C), channel_wise (C, C) -> (C, H, W) (paper, eq. 3 and 4)."""
    g = torch.sigmoid(torch.einsum("oc,chw->ohw", spatial, m) + biases[0][:, None, None]) * a
    scores = channel_wise @ g.flatten(1).mean(1) + biases[1]
    k = torch.exp(scores) / torch.exp(scores).sum() * len(a)
    return g * k[:, None, None] + a


Voxel = tuple[int, int, int]


class Voxels:
    """The voxels of one scan at strides 1, 2, 4, ...: dicts from (x, y, z) to a row, sorted by (x, y, z)."""

    def __init__(self, xyz: np.ndarray, size: float, strides: int) -> None:
        q = np.round(np.asarray(xyz, np.float32) / np.float32(size)).astype(np.int64)
        q = q - q.min(0)
        self.points: list[Voxel] = [tuple(map(int, row)) for row in q]
        self.rows: list[dict[Voxel, int]] = []
        for n in range(strides):
            self.rows.append({voxel: i for i, voxel in enumerate(sorted({floor(p, 2**n) for p in self.points}))})

    def neighbours(self, n: int) -> list[set[tuple[int, int]]]:
        """Per offset, x fastest: the pairs (input row, output row) at level n."""
        rows, s = self.rows[n], 2**n
        offsets = [(x, y, z) for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1)]
        return [{(rows[add(o, k, s)], row) for o, row in rows.items() if add(o, k, s) in rows} for k in offsets]

    def down(self, n: int) -> list[set[tuple[int, int]]]:
        """Per offset, z fastest: the pairs (row at level n - 1, row at level n)."""
        fine, s = self.rows[n - 1], 2 ** (n - 1)
        pairs = self.rows[n].items()
        return [
            {(fine[add(o, k, s)], row) for o, row in pairs if add(o, k, s) in fine}
            for k in itertools.product((0, 1), repeat=3)
        ]

    def corners(self, n: int) -> np.ndarray:
        """Matrix (P, V) of the interpolation from level n to the stride-1 voxels."""
        s, rows = 2**n, self.rows[n]
        matrix = np.zeros((len(self.rows[0]), len(rows)))
        for voxel, p in self.rows[0].items():
            base = floor(voxel, s)
            f = [(v - b) / s for v, b in zip(voxel, base, strict=True)]
            for d in itertools.product((0, 1), repeat=3):
                if add(base, d, s) in rows:
                    weight = np.prod([fi if di else 1 - fi for fi, di in zip(f, d, strict=True)])
                    matrix[p, rows[add(base, d, s)]] = weight
        return matrix / matrix.sum(1, keepdims=True)


def floor(voxel: Voxel, stride: int) -> Voxel:
    """The voxel at `stride` that holds `voxel`."""
    return tuple(v // stride * stride for v in voxel)


def add(voxel: Voxel, offset: Voxel, stride: int) -> Voxel:
    """voxel + stride * offset."""
    return tuple(v + stride * o for v, o in zip(voxel, offset, strict=True))


def sparse_convolution(
    x: np.ndarray, kernel: np.ndarray, pairs: list[set[tuple[int, int]]], outputs: int
) -> np.ndarray:
    """out[o] = sum over k of x[i] @ kernel[k] over the pairs (i, o) of k, in float64."""
    out = np.zeros((outputs, kernel.shape[2]))
    for weight, rows in zip(kernel.astype(np.float64), pairs, strict=True):
        for i, o in rows:
            out[o] += x[i].astype(np.float64) @ weight
    return out

"""The voxels of a scan at strides 1, 2, 4, ... and who is whose neighbour (paper, Sec. III-D).

A voxel is an int64 key: batch, x, y, z in fields of 9 + 3 x 18 bits. Keys are sorted, so neighbours are found
by binary search; a step by some voxels adds one number to a key, and the voxel of a coarser grid is the key
with the low bits of each field cleared. Plain PyTorch: CPU and CUDA.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from runtime.errors import ScanError

BITS = 18  # of a coordinate: 13 km of voxels of 5 cm
BATCH_LIMIT = 1 << 9  # scans in a batch


class KernelMap(NamedTuple):
    """Which rows meet: output row `target[k][p]` collects input row `source[k][p]` times kernel[k].

    Within one k no row appears twice. None stands for "every row with itself".
    """

    source: tuple[Tensor | None, ...]  # K x (P_k,) int64
    target: tuple[Tensor | None, ...]  # K x (P_k,) int64
    outputs: int  # rows of the output


class Corners(NamedTuple):
    """Trilinear interpolation: the value at p is the sum over d of weight[p, d] * (value of row[p, d])."""

    row: Tensor  # (P, 8) int64; 0 where there is no such voxel
    weight: Tensor  # (P, 8) float32, sum 1; 0 where there is no such voxel


class Level(NamedTuple):
    """The occupied voxels of one stride."""

    stride: int
    keys: Tensor  # (V,) int64, rising
    neighbours: KernelMap  # 3x3x3, from this level to itself
    down: KernelMap | None  # 2x2x2, from the next finer level to this one; None at stride 1
    up: KernelMap | None  # 2x2x2, from this level to the next finer one; None at stride 1
    ancestor: Tensor  # (P,) int64: the row here that holds each stride-1 voxel


@dataclass(frozen=True)
class VoxelGrid:
    """The voxels of one scan, or of a batch of scans; built once, used by every layer of the point head."""

    levels: tuple[Level, ...]  # strides 1, 2, 4, ...
    inverse: Tensor  # (N,) int64: the stride-1 row of each point
    first: Tensor  # (P,) int64: the first point, in scan order, of each stride-1 voxel

    @classmethod
    def from_points(
        cls, xyz: Tensor, voxel_size: float, strides: int, batch: Tensor | None = None, still: bool = False
    ) -> "VoxelGrid":
        """Voxels of xyz (N, 3) m at `strides` levels; `batch` (N,) int64 tells the scans of a batch apart.

        Coordinates are rounded in float32, half to even, and count from the minimum of each scan; points that
        have no pixel must be left out. still: from the corner of the coarsest voxel in which that lies, so that no
        point shifts the grids of the others. Raises ScanError for points that are not finite or too far apart.
        """
        step = 1 << strides - 1 if still else 1
        keys = voxel_keys(xyz, voxel_size, batch, margin=1 << strides, step=step)  # (N,)
        order = keys.argsort(stable=True)  # (N,)
        ranked = keys[order]  # (N,)
        is_new = torch.ones_like(ranked, dtype=torch.bool)  # (N,)
        is_new[1:] = ranked[1:] != ranked[:-1]
        inverse = torch.empty_like(order)  # (N,)
        inverse[order] = is_new.cumsum(0) - 1
        keys = ranked[is_new]  # (P,)
        levels = [Level(1, keys, _neighbour_map(keys, 1), None, None, torch.arange(len(keys), device=keys.device))]
        for _ in range(1, strides):
            levels.append(_coarsen(levels[-1]))
        return cls(tuple(levels), inverse, order[is_new])

    def corners(self, n: int) -> Corners:
        """The voxels of level n around each stride-1 voxel (which sits at its lower corner)."""
        stride, base = self.levels[n].stride, self.levels[0].keys  # (P,)
        lower = coarser(base, stride)  # (P,)
        f = _coordinates(base - lower).float() / stride  # (3, P) 0..1
        rows, weights = [], []
        for d in ((x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)):
            row, found = find(self.levels[n].keys, lower + stride * offset_key(*d))  # (P,), (P,)
            fx, fy, fz = (f[i] if d[i] else 1 - f[i] for i in range(3))  # (P,)
            rows.append(row * found)
            weights.append(fx * fy * fz * found)
        weight = torch.stack(weights, 1)  # (P, 8)
        return Corners(torch.stack(rows, 1), weight / weight.sum(1, keepdim=True))


def voxel_keys(xyz: Tensor, voxel_size: float, batch: Tensor | None, margin: int, step: int = 1) -> Tensor:
    """Keys (N,) int64 of points (N, 3) m; `margin` cells stay free at the upper end of each axis.

    They count from the minimum of each scan, down to a multiple of `step` cells.

    So a step of less than `margin` cells, up or down, never lands on another voxel's key by overflow.
    """
    if xyz.ndim != 2 or xyz.shape[1] != 3 or not xyz.is_floating_point():
        raise ScanError(f"points must be (N, 3) floats, not {tuple(xyz.shape)} {xyz.dtype}")
    if batch is None:
        batch = torch.zeros(len(xyz), dtype=torch.int64, device=xyz.device)  # (N,)
    if batch.shape != xyz.shape[:1] or batch.dtype != torch.int64:
        raise ScanError(f"batch must be ({len(xyz)},) int64, not {tuple(batch.shape)} {batch.dtype}")
    if not len(xyz):
        return batch
    if batch.min() < 0 or batch.max() >= BATCH_LIMIT:
        raise ScanError(f"batch must lie within 0..{BATCH_LIMIT - 1}: use smaller batches")
    # A tensor on the device: CUDA would multiply by the reciprocal of a plain number, which rounds otherwise.
    size = torch.tensor(voxel_size, dtype=torch.float32, device=xyz.device)
    q = (xyz.float() / size).round()  # (N, 3), half to even
    if not (q.abs() < 2**31).all():  # also false for NaN
        raise ScanError(f"points must be finite and within {2**31 * voxel_size:.0f} m: leave others out")
    q = q.long()  # (N, 3)
    low = q.new_full((int(batch.max()) + 1, 3), 2**31)  # (B, 3)
    low.scatter_reduce_(0, batch[:, None].expand(-1, 3), q, "amin")
    low = low.div(step, rounding_mode="floor") * step  # (B, 3)
    q = q - low[batch]  # (N, 3) from 0
    spread, limit = int(q.max()), (1 << BITS) - margin
    if spread >= limit:
        raise ScanError(f"a scan spreads over {spread} voxels along an axis; {limit} are possible")
    x, y, z = q.unbind(1)  # (N,) each
    return (((batch << BITS) + x << BITS) + y << BITS) + z


def offset_key(x: int, y: int, z: int) -> int:
    """What a step of (x, y, z) voxels adds to a key."""
    return (((x << BITS) + y) << BITS) + z


def coarser(keys: Tensor, stride: int) -> Tensor:
    """Keys of the voxels at `stride` that hold the voxels `keys` (same shape)."""
    low = stride - 1
    return keys & ~offset_key(low, low, low)


def find(keys: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Row of each wanted key in sorted `keys`, and whether it is there (both as `wanted` in shape)."""
    if not len(keys):
        return torch.zeros_like(wanted), torch.zeros_like(wanted, dtype=torch.bool)
    row = torch.searchsorted(keys, wanted).clamp_(max=len(keys) - 1)
    return row, keys[row] == wanted


def _coordinates(keys: Tensor) -> Tensor:
    """x, y, z of keys (V,) as (3, V)."""
    return torch.stack([keys >> (axis * BITS) & ((1 << BITS) - 1) for axis in (2, 1, 0)])


def _coarsen(finer: Level) -> Level:
    stride = 2 * finer.stride
    keys, parent = torch.unique(coarser(finer.keys, stride), return_inverse=True)  # (V,), (F,)
    down = _down_map(finer, parent, len(keys))
    up = KernelMap(down.target, down.source, len(finer.keys))
    return Level(stride, keys, _neighbour_map(keys, stride), down, up, parent[finer.ancestor])


def _neighbour_map(keys: Tensor, stride: int) -> KernelMap:
    """3x3x3, x varying fastest. Offsets k and 26 - k are each other's reverse: half the searches do."""
    steps = [(x, y, z) for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1)][:13]
    shifts = torch.tensor([stride * offset_key(*step) for step in steps], device=keys.device)  # (13,)
    row, found = find(keys, keys + shifts[:, None])  # (13, V), (13, V)
    counts = found.sum(1).tolist()
    source = torch.split(row[found], counts)  # 13 x (P_k,)
    target = torch.split(found.nonzero()[:, 1], counts)  # 13 x (P_k,)
    return KernelMap((*source, None, *target[::-1]), (*target, None, *source[::-1]), len(keys))


def _down_map(finer: Level, parent: Tensor, outputs: int) -> KernelMap:
    """2x2x2, z varying fastest: every finer voxel goes to its parent, by the corner in which it lies."""
    x, y, z = _coordinates(finer.keys) // finer.stride & 1  # (F,) 0 or 1 each
    corner = 4 * x + 2 * y + z  # (F,)
    source = tuple((corner == k).nonzero()[:, 0] for k in range(8))  # 8 x (P_k,)
    return KernelMap(source, tuple(parent[rows] for rows in source), outputs)

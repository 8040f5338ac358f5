"""The point head: a sparse-convolution U-net over voxels with a branch of point MLPs (paper, Sec. III-D).

It refines the classes of single points, which the range image blurs at the edges of objects. Layers have the names
of `runtime.head.weights.layers`. Every stride-1 voxel is one "point" of the point branch.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from mos_model.networks.sparse import SparseConv, points_to_voxels, voxels_to_points
from mos_model.networks.voxels import KernelMap, Level, VoxelGrid
from runtime.bundle.head_shape import PointHeadConfig
from runtime.classes import CLASSES
from runtime.errors import ScanError


class RowNorm(nn.BatchNorm1d):
    """BatchNorm over rows (V, c). Fewer than two have no variance: they are treated as in evaluation."""

    def forward(self, x: Tensor) -> Tensor:
        if self.training and len(x) < 2:
            return F.batch_norm(x, self.running_mean, self.running_var, self.weight, self.bias, eps=self.eps)
        return super().forward(x)


class SparseConvNorm(SparseConv):
    """Sparse convolution -> BatchNorm."""

    def __init__(self, i: int, o: int, volume: int) -> None:
        super().__init__(i, o, volume)
        self.norm = RowNorm(o)

    def forward(self, x: Tensor, pairs: KernelMap | None = None) -> Tensor:
        """(V, i) -> (V', o)."""
        x = self.norm(super().forward(x, pairs))
        return x


class DenseNorm(nn.Linear):
    """Linear layer -> BatchNorm -> ReLU."""

    def __init__(self, i: int, o: int) -> None:
        super().__init__(i, o)
        self.norm = RowNorm(o)

    def forward(self, x: Tensor) -> Tensor:
        """(P, i) -> (P, o)."""
        return F.relu(self.norm(super().forward(x)))


class Residual(nn.Module):
    """Two 3x3x3 convolutions and a shortcut."""

    def __init__(self, i: int, o: int) -> None:
        super().__init__()
        self.conv1 = SparseConvNorm(i, o, 27)
        self.conv2 = SparseConvNorm(o, o, 27)
        self.shortcut = SparseConvNorm(i, o, 1) if i != o else nn.Identity()

    def forward(self, x: Tensor, level: Level) -> Tensor:
        a = F.relu(self.conv1(x, level.neighbours))  # (V, o)
        b = self.conv2(a, level.neighbours)  # (V, o)
        return F.relu(b + self.shortcut(x))  # (V, o)


class PointHead(nn.Module):
    """forward(grid, features (N, in_channels)) -> logits (N, 3). Computes in the precision of its weights."""

    def __init__(self, config: PointHeadConfig) -> None:
        super().__init__()
        self.config = config
        self.depth = len(config.down)
        c, skips = config.in_channels, (config.in_channels, *config.down)
        self.stem = SparseConvNorm(c, c, 27)
        for n, (i, o) in enumerate(zip(skips, config.down, strict=False), 1):
            setattr(self, f"stage{n}", nn.ModuleList([SparseConvNorm(i, i, 8), Residual(i, o), Residual(o, o)]))
        for n, (i, o) in enumerate(zip((config.down[-1], *config.up), config.up, strict=False), 1):
            residuals = nn.ModuleList([Residual(o + skips[self.depth - n], o), Residual(o, o)])
            setattr(self, f"up{n}", nn.ModuleList([SparseConvNorm(i, o, 8), residuals]))
        joined = [] if config.fuse_after_up is None else [config.up[config.fuse_after_up - 1]]
        widths = [c, config.down[-1], *joined, config.up[-1]]
        self.point_transforms = nn.ModuleList(DenseNorm(i, o) for i, o in pairwise(widths))
        self.classifier = nn.Linear(config.up[-1], len(CLASSES))
        self.dropout = nn.Dropout(config.dropout)

    def grid(self, xyz: Tensor, batch: Tensor | None = None) -> VoxelGrid:
        """What forward needs to know of points xyz (N, 3) float32 m; `batch` (N,) int64 tells scans apart."""
        still = self.config.reduce == "mean"
        return VoxelGrid.from_points(xyz, self.config.voxel_size, self.depth + 1, batch, still)

    def forward(self, grid: VoxelGrid, features: Tensor) -> Tensor:
        """Logits (N, 3) of the points of `grid` from their image features (N, in_channels)."""
        if features.shape != (len(grid.inverse), self.config.in_channels):
            raise ScanError(
                f"features must be ({len(grid.inverse)}, {self.config.in_channels}) for this grid and head, "
                f"not {tuple(features.shape)}"
            )
        with torch.autocast(features.device.type, enabled=False):
            logits = self._voxel_logits(grid, features.to(self.stem.kernel.dtype))  # (P, 3)
        return logits.index_select(0, grid.inverse)  # (N, 3)

    def _voxel_logits(self, grid: VoxelGrid, features: Tensor) -> Tensor:
        """features (N, c) -> logits (P, 3). Shapes are the full head's; V are the voxels of the level."""
        mlps = iter(self.point_transforms)
        x = self._reduce(grid, features)  # (P, 32)
        x = F.relu(self.stem(x, grid.levels[0].neighbours))  # (P, 32)
        z, skips = x, [x]
        for n in range(1, self.depth + 1):
            x = self._encode(n, x, grid)  # (V, 32), (V, 64), (V, 128), (V, 256)
            skips.append(x)
        x, z = self._join(x, z, grid, self.depth, next(mlps))  # (V, 256), (P, 256)
        for n in range(1, self.depth + 1):
            x = self._decode(n, x, skips[self.depth - n], grid)  # (V, 256), (V, 128), (V, 96), (P, 96)
            if n == self.config.fuse_after_up:
                x, z = self._join(x, z, grid, self.depth - n, next(mlps))  # (V, 128), (P, 128)
        z = x + next(mlps)(z)  # (P, 96); at stride 1 a voxel is its own point
        logits: Tensor = self.classifier(z)  # (P, 3)
        return logits

    def _reduce(self, grid: VoxelGrid, features: Tensor) -> Tensor:
        """Feature of each stride-1 voxel, (N, c) -> (P, c)."""
        if self.config.reduce == "first":
            return features.index_select(0, grid.first)
        return points_to_voxels(features, grid.inverse, len(grid.first))

    def _encode(self, n: int, x: Tensor, grid: VoxelGrid) -> Tensor:
        down, first, second = getattr(self, f"stage{n}")
        level = grid.levels[n]
        x = F.relu(down(x, level.down))  # (V, i)
        x = second(first(x, level), level)  # (V, o)
        return x

    def _decode(self, n: int, x: Tensor, skip: Tensor, grid: VoxelGrid) -> Tensor:
        up, (first, second) = getattr(self, f"up{n}")
        coarse, fine = grid.levels[self.depth - n + 1], grid.levels[self.depth - n]
        x = torch.cat((F.relu(up(x, coarse.up)), skip), 1)  # (V, o + skip)
        x = second(first(x, fine), fine)  # (V, o)
        return x

    def _join(self, x: Tensor, z: Tensor, grid: VoxelGrid, n: int, mlp: nn.Module) -> tuple[Tensor, Tensor]:
        """Point branch meets voxel branch at level n: z = v2p(x) + mlp(z), x = dropout(p2v(z))."""
        z = voxels_to_points(x, grid.corners(n)) + mlp(z)  # (P, o)
        level = grid.levels[n]
        x = points_to_voxels(z, level.ancestor, len(level.keys))  # (V, o)
        return self.dropout(x), z

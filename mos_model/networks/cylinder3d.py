"""Cylinder3D (Zhu et al., CVPR 2021), as MotionSeg3D compares with it: two aligned scans, with the time as a feature.

Points go through an MLP, and the greatest of each channel into cells of equal angles. A U-net over the occupied cells
has asymmetric residual blocks, kernels 3x1x3 and 1x3x3 in both orders, sparse convolutions down and back up, and a
context of three kernels of one dimension each, whose sigmoids weigh the features. Points take what their cell says
together with what they said themselves. Widths, grid and order of the layers are those of the public code
(https://github.com/xinge008/Cylinder3D, Apache 2.0; read for facts, nothing copied). What is chosen here:

- points out of the cylinder are static (there they are moved onto its border), and a cell is the extent of the
  cylinder divided by their number (there by one less);
- time is 0 and 1, in scans back, and a past scan has no remission: a runner remembers places only;
- the refinement of points, which the paper has and the public code leaves out: one hidden layer of c channels over the
  features of cell and point. Where that code classifies cells, a convolution 3x3x3, nothing is left to do;
- one loss, of points, as of the other networks here.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from mos_model.networks.config import ModelConfig
from mos_model.networks.cylinder_grid import CellLevel, CylinderGrid
from mos_model.networks.image_output import ImageOutput
from mos_model.networks.point_head import DenseNorm, RowNorm
from mos_model.networks.sparse import SparseConv
from runtime.bundle.residual import Residual
from runtime.bundle.view import POINT_CHANNELS, CylinderView, View
from runtime.classes import CLASSES
from runtime.head.cylinder.cells import KERNELS
from runtime.head.cylinder.cylinder_layers import AXES, ORDERS, UP
from runtime.head.sparse.kernel import SLOPE


@dataclass(frozen=True)
class Cylinder3DConfig(ModelConfig):
    """The paper's comparator of points and voxels. Default: the published widths and grid."""

    kind: ClassVar[str] = "cylinder3d"
    named: ClassVar[Mapping[str, Mapping[str, Any]]] = {"cylinder3d": {}}

    name: str = "cylinder3d"
    residual: Residual = field(default_factory=lambda: Residual(lags=(1,)))
    cylinder: CylinderView = field(default_factory=CylinderView)

    def build_image_network(self) -> nn.Module:
        """See `ModelConfig`; the image is a list of points, of any number."""
        return Cylinder3D(self)

    @property
    def view(self) -> View:
        """See `ModelConfig`."""
        return View(self.range_image, self.residual, cylinder=self.cylinder)


class ConvActNorm(SparseConv):
    """Sparse convolution -> LeakyReLU -> BatchNorm."""

    def __init__(self, i: int, o: int, kernel: str) -> None:
        super().__init__(i, o, len(KERNELS[kernel]))
        self.size, self.norm = kernel, RowNorm(o)

    def forward(self, x: Tensor, level: CellLevel) -> Tensor:  # type: ignore[override]
        """(V, i) -> (V, o)."""
        x = self.norm(F.leaky_relu(super().forward(x, level.within(self.size)), SLOPE))
        return x


class Asymmetric(nn.ModuleList):
    """Two flat kernels one after the other, in both orders; the sum of the two."""

    def __init__(self, i: int, o: int) -> None:
        super().__init__(nn.ModuleList([ConvActNorm(i, o, a), ConvActNorm(o, o, b)]) for a, b in ORDERS)

    def forward(self, x: Tensor, level: CellLevel) -> Tensor:
        """(V, i) -> (V, o)."""
        branches = [branch[1](branch[0](x, level), level) for branch in self]  # type: ignore[index]
        total: Tensor = branches[0] + branches[1]
        return total


class Down(nn.Module):
    """An asymmetric block; its output is the skip, and what the next scale takes of it."""

    def __init__(self, i: int, o: int) -> None:
        super().__init__()
        self.block, self.pool = Asymmetric(i, o), SparseConv(o, o, 27)

    def forward(self, x: Tensor, fine: CellLevel, coarse: CellLevel) -> tuple[Tensor, Tensor]:
        """(V, i) -> (V', o), (V, o)."""
        x = self.block(x, fine)
        return self.pool(x, coarse.down), x


class UpCells(nn.Module):
    """Back to the finer scale, onto the skip, and a block of three convolutions there."""

    def __init__(self, i: int, o: int) -> None:
        super().__init__()
        self.before, self.climb = ConvActNorm(i, o, "3x3x3"), SparseConv(o, o, 27)
        self.block = nn.ModuleList(ConvActNorm(o, o, kernel) for kernel in UP)

    def forward(self, x: Tensor, skip: Tensor, coarse: CellLevel, fine: CellLevel) -> Tensor:
        """(V', i) -> (V, o)."""
        x = self.climb(self.before(x, coarse), coarse.up) + skip
        for layer in self.block:
            x = layer(x, fine)
        return x


class AxisNorm(SparseConv):
    """Sparse convolution along one axis -> BatchNorm -> sigmoid."""

    def __init__(self, channels: int, kernel: str) -> None:
        super().__init__(channels, channels, 3)
        self.size, self.norm = kernel, RowNorm(channels)

    def forward(self, x: Tensor, level: CellLevel) -> Tensor:  # type: ignore[override]
        """(V, c) -> (V, c)."""
        return torch.sigmoid(self.norm(super().forward(x, level.within(self.size))))


class Refinement(nn.Module):
    """What a cell says (V, i) and what a point of it says (P, j), to features of the point (P, o)."""

    def __init__(self, i: int, j: int, o: int) -> None:
        super().__init__()
        self.cells, self.points, self.norm = nn.Linear(i, o, bias=False), nn.Linear(j, o), RowNorm(o)

    def forward(self, cells: Tensor, points: Tensor, home: Tensor) -> Tensor:
        """home (P,): the row of each point's cell."""
        return F.relu(self.norm(self.cells(cells)[home] + self.points(points)))


class Cylinder3D(nn.Module):
    """forward(image (B, 11, 1, M)) -> scores and features of every point; those without a cell get zeros."""

    def __init__(self, config: Cylinder3DConfig) -> None:
        super().__init__()
        c = config.channels
        self.size, self.width = config.cylinder.cells, c
        self.norm = RowNorm(POINT_CHANNELS)
        widths = (POINT_CHANNELS, 2 * c, 4 * c, 8 * c)
        self.points = nn.ModuleList([*(DenseNorm(i, o) for i, o in pairwise(widths)), nn.Linear(8 * c, 8 * c)])
        self.compress = nn.Linear(8 * c, c // 2)
        self.context = Asymmetric(c // 2, c)
        for n, (i, o) in enumerate(pairwise((c, 2 * c, 4 * c, 8 * c, 16 * c)), 1):
            setattr(self, f"down{n}", Down(i, o))
        for n, (i, o) in enumerate(pairwise((16 * c, 16 * c, 8 * c, 4 * c, 2 * c)), 1):
            setattr(self, f"up{n}", UpCells(i, o))
        self.axes = nn.ModuleList(AxisNorm(2 * c, kernel) for kernel in AXES)
        self.refine = Refinement(4 * c, 8 * c, c)
        self.classifier = nn.Linear(c, len(CLASSES))

    def forward(self, image: Tensor) -> ImageOutput:
        """image (B, 11, 1, M) float32, as of `runtime.image.cylinder_inputs`."""
        batch, _, height, width = image.shape
        with torch.autocast(image.device.type, enabled=False):
            rows = image.float().movedim(1, -1).reshape(-1, POINT_CHANNELS + 1)  # (B M, 11)
            (seen,) = (rows[:, -1] >= 0).nonzero(as_tuple=True)  # (P,)
            points = rows[seen]
            scan = seen // (height * width)
            features = self._features(points[:, :-1], CylinderGrid.of(points[:, -1].long(), scan, self.size))  # (P, c)
            of_all = []
            for values in (self.classifier(features), features):
                spread = values.new_zeros(len(rows), values.shape[1]).index_copy(0, seen, values)
                of_all.append(spread.reshape(batch, height, width, values.shape[1]).movedim(-1, 1))
        return ImageOutput(*of_all)  # (B, 3, 1, M), (B, c, 1, M)

    def _features(self, points: Tensor, grid: CylinderGrid) -> Tensor:
        """(P, 10) -> (P, c)."""
        points = self.norm(points)
        for layer in self.points:
            points = layer(points)  # (P, 2 c), (P, 4 c), (P, 8 c), (P, 8 c)
        levels, home = grid.levels, grid.home
        pooled = points.new_zeros(len(levels[0].keys), points.shape[1])
        pooled = pooled.scatter_reduce(0, home[:, None].expand_as(points), points, "amax", include_self=False)
        x = self.context(F.relu(self.compress(pooled)), levels[0])  # (V, c)
        skips = []
        for n, (fine, coarse) in enumerate(pairwise(levels), 1):
            x, skip = getattr(self, f"down{n}")(x, fine, coarse)  # (V, 2 c), (V, 4 c), (V, 8 c), (V, 16 c)
            skips.append(skip)
        for n, (coarse, fine) in enumerate(pairwise(reversed(levels)), 1):
            x = getattr(self, f"up{n}")(x, skips.pop(), coarse, fine)  # (V, 16 c), (V, 8 c), (V, 4 c), (V, 2 c)
        gate: Tensor = sum(axis(x, levels[0]) for axis in self.axes)
        found: Tensor = self.refine(torch.cat((gate * x, x), 1), points, home)
        return found

"""The occupied cells of a cylinder at five scales and who meets whom, in plain PyTorch: CPU and CUDA.

A cell is an int64 key, the number of the cell in all scans of the batch. Keys are sorted, so that cells are found by
binary search. Offsets and scales are those of `runtime.head.cylinder.cells`.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor

from mos_model.networks.voxels import KernelMap, find
from runtime.head.cylinder.cells import KERNELS, STRIDES, Cells

OFFSETS = tuple(product((-1, 0, 1), repeat=3))


class CellLevel(NamedTuple):
    """The cells of one scale."""

    size: Cells
    keys: Tensor  # (V,) int64, rising
    around: KernelMap  # 3x3x3, within the scale
    down: KernelMap | None  # 3x3x3, from the finer scale to this one; None at the finest
    up: KernelMap | None  # back, by the same pairs

    def within(self, kernel: str) -> KernelMap:
        """The map of one of KERNELS within the scale."""
        columns = KERNELS[kernel].tolist()
        source, target, count = self.around
        return KernelMap(tuple(source[k] for k in columns), tuple(target[k] for k in columns), count)


@dataclass(frozen=True)
class CylinderGrid:
    """The cells of a batch of scans; built once, used by every layer."""

    levels: tuple[CellLevel, ...]
    home: Tensor  # (P,) int64: the finest row of each point

    @classmethod
    def of(cls, cells: Tensor, batch: Tensor, size: Cells) -> "CylinderGrid":
        """From the cell of each point, (P,) int64 below the product of `size`, and its scan, (P,) int64."""
        keys, home = torch.unique(batch * (size[0] * size[1] * size[2]) + cells, return_inverse=True)
        levels = [CellLevel(size, keys, _around(keys, size), None, None)]
        for stride in STRIDES:
            levels.append(_coarser(levels[-1], stride))
        return cls(tuple(levels), home)


def _places(keys: Tensor, size: Cells) -> Tensor:
    """Scan, ring, sector and layer of keys (V,), as (4, V)."""
    rest, layer = keys // size[2], keys % size[2]
    rest, sector = rest // size[1], rest % size[1]
    return torch.stack([rest // size[0], rest % size[0], sector, layer])


def _keys(places: Tensor, size: Cells) -> tuple[Tensor, Tensor]:
    """Keys of places (4, V), and which of them are in the cylinder."""
    scan, *axes = places
    inside = torch.ones_like(scan, dtype=torch.bool)
    key = scan
    for place, count in zip(axes, size, strict=True):
        inside &= (place >= 0) & (place < count)
        key = key * count + place
    return key, inside


def _around(keys: Tensor, size: Cells) -> KernelMap:
    places, source, target = _places(keys, size), [], []
    for offset in OFFSETS:
        wanted, inside = _keys(places + places.new_tensor((0, *offset))[:, None], size)
        row, found = find(keys, wanted)
        (there,) = (found & inside).nonzero(as_tuple=True)
        source.append(row[there])
        target.append(there)
    return KernelMap(tuple(source), tuple(target), len(keys))


def _coarser(fine: CellLevel, stride: Cells) -> CellLevel:
    x, y, z = (-(-n // s) for n, s in zip(fine.size, stride, strict=True))
    size = x, y, z
    places, by = _places(fine.keys, fine.size), fine.keys.new_tensor((1, *stride))[:, None]
    source, above = [], []
    for offset in OFFSETS:
        shifted = places - places.new_tensor((0, *offset))[:, None]  # stride times the coarser cell, if that is whole
        key, inside = _keys(shifted.div(by, rounding_mode="floor"), size)
        (there,) = (inside & (shifted % by == 0).all(0)).nonzero(as_tuple=True)
        source.append(there)
        above.append(key[there])
    keys, rows = torch.unique(torch.cat(above), return_inverse=True)
    target = rows.split([len(one) for one in above])
    down = KernelMap(tuple(source), target, len(keys))
    return CellLevel(size, keys, _around(keys, size), down, KernelMap(target, down.source, len(fine.keys)))

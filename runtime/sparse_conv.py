"""Sparse convolution on a CPU near its peak: rows read in place; bias, residual and ReLU in the same pass.

    weights = pack(kernel, bias)                                   # once
    out = np.empty((kernel_map.count_out, weights.columns), np.float32)
    convolve(features, kernel_map, weights, out, workers)          # relu(conv(features) + bias)

Kernel maps come from `runtime.kernel_map`, voxels from `runtime.voxels`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.arena import aligned_empty
from runtime.errors import ScanError
from runtime.kernel_map import KernelMap, tile_size
from runtime.sparse_kernel import LANES, convolve_tiles
from runtime.workers import Workers

_TASKS_PER_THREAD = 32  # of one layer: the fewer, the longer the threads wait for the last


@dataclass(frozen=True)
class Packed:
    """Weights of a convolution with K offsets (K = 1: a dense layer), in the order in which they are read."""

    panels: NDArray[np.float32]  # (K, columns / 16, rows, 16)
    bias: NDArray[np.float32]  # (columns,)

    @property
    def rows(self) -> int:
        """Input channels, filled up."""
        return int(self.panels.shape[2])

    @property
    def columns(self) -> int:
        """Output channels, filled up."""
        return len(self.bias)


def padded(channels: int) -> int:
    """Channels filled up to whole panels."""
    return -(-channels // LANES) * LANES


def pack(
    weight: NDArray[np.float32], bias: NDArray[np.float32] | None = None, parts: Sequence[int] | None = None
) -> Packed:
    """Pack `weight` (K, in, out) or (in, out) and `bias` (out,), filled up with zeros to whole panels.

    `parts` names the widths of concatenated inputs, each of which is filled up by itself (default: one).
    """
    weight = np.asarray(weight, np.float32).reshape((-1, *weight.shape[-2:]))
    offsets, rows, columns = weight.shape
    parts = [rows] if parts is None else parts
    full = np.zeros((offsets, sum(map(padded, parts)), padded(columns)), np.float32)
    source = target = 0
    for part in parts:
        full[:, target : target + part, :columns] = weight[:, source : source + part]
        source, target = source + part, target + padded(part)
    panels = aligned_empty((offsets, full.shape[2] // LANES, full.shape[1], LANES), np.float32)
    panels[:] = full.reshape(offsets, full.shape[1], full.shape[2] // LANES, LANES).transpose(0, 2, 1, 3)
    filled = np.zeros(full.shape[2], np.float32)
    if bias is not None:
        filled[:columns] = bias
    return Packed(panels, filled)


_NO_PAIRS = np.zeros(0, np.int32)
_NO_WEIGHTS = pack(np.zeros((0, LANES, LANES), np.float32))


def convolve(
    features: NDArray[np.float32],
    kernel_map: KernelMap,
    weights: Packed,
    out: NDArray[np.float32],
    workers: Workers,
    *,
    residual: NDArray[np.float32] | None = None,
    shortcut: tuple[NDArray[np.float32], Packed] | None = None,
    relu: bool = True,
) -> NDArray[np.float32]:
    """`out[o] = relu(bias + sum_k features[o + offset_k] @ W[k] + residual[o] + shortcut of row o)`.

    `features` (V_in, rows), `out` (V_out, columns) and `residual` (V_out, columns) are float32 with filled-up
    widths and contiguous rows; they may be columns of a wider array, so that a concatenation needs no copy.
    `shortcut`: features (V_out, c) and the weights of a dense layer, added before ReLU. `out` may be the
    residual, but none of the other inputs. Returns `out`. Raises ScanError where an array does not fit.
    """
    _check(features, kernel_map.count_in, weights.rows, "features")
    return _run(features, kernel_map, weights, out, workers, residual, shortcut, relu)


def dense(
    features: NDArray[np.float32], weights: Packed, out: NDArray[np.float32], workers: Workers
) -> NDArray[np.float32]:
    """`out = relu(features @ W + bias)` row by row; arrays as in `convolve`."""
    count, starts = len(out), _NO_PAIRS.reshape(0, 1)
    no_map = KernelMap(_NO_PAIRS, _NO_PAIRS, starts, tile_size(count, workers), 0, count, 0)
    return _run(features, no_map, _NO_WEIGHTS, out, workers, None, (features, weights), True)


def _run(
    features: NDArray[np.float32],
    kernel_map: KernelMap,
    weights: Packed,
    out: NDArray[np.float32],
    workers: Workers,
    residual: NDArray[np.float32] | None,
    shortcut: tuple[NDArray[np.float32], Packed] | None,
    relu: bool,
) -> NDArray[np.float32]:
    count, columns = kernel_map.count_out, out.shape[1]
    _check(out, count, columns, "out")
    before = out if residual is None else residual
    _check(before, count, columns, "residual")
    side, side_weights, bias = out, _NO_WEIGHTS, weights.bias
    if shortcut is not None:
        side, side_weights = shortcut
        _check(side, count, side_weights.rows, "shortcut")
        bias = side_weights.bias + (bias if weights.panels.size else np.float32(0))
    if bias.size != columns:
        raise ScanError(f"out has {columns} columns, the weights have {bias.size}")

    def task(first: int, last: int) -> None:
        convolve_tiles(
            _address(features), features.strides[0] // 4, weights.panels,
            kernel_map.inputs, kernel_map.outputs, kernel_map.starts,
            _address(side), side.strides[0] // 4, side_weights.panels, bias,
            _address(before), before.strides[0] // 4, residual is not None,
            _address(out), out.strides[0] // 4, relu,
            kernel_map.tile, count, first, last,
        )  # fmt: skip

    tiles = -(-count // kernel_map.tile)
    workers.ranges(task, tiles, max(1, tiles // (_TASKS_PER_THREAD * workers.threads)))
    return out


def _check(array: NDArray[np.float32], count: int, columns: int, name: str) -> None:
    rows_are_whole = array.size == 0 or array.strides[1] == array.itemsize
    if array.dtype != np.float32 or array.shape != (count, columns) or not rows_are_whole:
        raise ScanError(
            f"{name} must be a ({count}, {columns}) float32 array with contiguous rows, "
            f"not {array.dtype} {array.shape} with strides {array.strides}"
        )


def _address(array: NDArray[np.float32]) -> int:
    return int(array.__array_interface__["data"][0])

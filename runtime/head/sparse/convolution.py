"""Sparse convolution on a CPU near its peak: rows read in place; bias, residual and ReLU in the same pass.

    weights = pack(kernel, bias)                                   # once
    out = np.empty((kernel_map.count_out, weights.columns), np.float32)
    convolve(features, kernel_map, weights, out, workers)          # relu(conv(features) + bias)

Kernel maps come from `runtime.head.sparse.kernel_map`, voxels from `runtime.head.voxels`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.compute.arena import aligned_empty
from runtime.compute.workers import Workers
from runtime.errors import ScanError
from runtime.head.sparse.kernel import FIELDS, LANES, address, run_layers
from runtime.head.sparse.kernel_map import KernelMap, tile_size
from runtime.head.sparse.map_check import check_map

_TASKS_PER_THREAD = 4  # of one layer, at least; where it has too few tiles, each is done in parts


@dataclass(frozen=True)
class Packed:
    """Weights of a convolution with K offsets (K = 1: a dense layer), in the order in which they are read."""

    panels: NDArray[np.float32]  # (K, columns / 16, rows, 16)
    bias: NDArray[np.float32]  # (columns,)
    after: NDArray[np.float32] | None = None  # (2, columns) scale and shift behind a LeakyReLU; None: there is none

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
    weight: NDArray[np.float32],
    bias: NDArray[np.float32] | None = None,
    parts: Sequence[int] | None = None,
    after: NDArray[np.float32] | None = None,
) -> Packed:
    """Pack `weight` (K, in, out) or (in, out) and `bias` (out,), filled up with zeros to whole panels.

    `parts` names the widths of concatenated inputs, each of which is filled up by itself (default: one). `after`
    (2, out): scale and shift of a BatchNorm behind a LeakyReLU. Raises ScanError where they do not fit.
    """
    weight = np.asarray(weight, np.float32).reshape((-1, *weight.shape[-2:]))
    offsets, rows, columns = weight.shape
    parts = [rows] if parts is None else parts
    if sum(parts) != rows or (bias is not None and bias.shape != (columns,)):
        raise ScanError(f"weights of {rows} x {columns} channels fit neither parts of {list(parts)} nor another bias")
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
    if after is None:
        return Packed(panels, filled)
    if after.shape != (2, columns):
        raise ScanError(f"a scale and a shift of {columns} channels must be (2, {columns}), not {after.shape}")
    norm = np.zeros((2, full.shape[2]), np.float32)
    norm[:, :columns] = after
    return Packed(panels, filled, norm)


class Layers:
    """Layers that all threads work through together, without going back to the interpreter in between.

    Add them in the order of computation, then `run`, which does all reading and writing of the arrays.
    """

    def __init__(self, workers: Workers) -> None:
        self.workers = workers
        self._rows: list[list[int]] = []
        self._arrays: list[object] = []  # those whose addresses are in _rows

    def convolve(
        self,
        features: NDArray[np.float32],
        kernel_map: KernelMap,
        weights: Packed,
        out: NDArray[np.float32],
        *,
        residual: NDArray[np.float32] | None = None,
        shortcut: tuple[NDArray[np.float32], Packed] | None = None,
        relu: bool = True,
    ) -> NDArray[np.float32]:
        """Add a convolution; arguments, result and errors as of the function `convolve`."""
        _check(features, kernel_map.count_in, weights.rows, "features")
        if kernel_map.starts.shape[1] != len(weights.panels) + 1:
            raise ScanError(
                f"the kernel map has {kernel_map.starts.shape[1] - 1} offsets, the weights have {len(weights.panels)}"
            )
        return self._add(features, kernel_map, weights, out, residual, shortcut, relu)

    def dense(
        self, features: NDArray[np.float32], weights: Packed, out: NDArray[np.float32], relu: bool = True
    ) -> NDArray[np.float32]:
        """Add a dense layer; arguments, result and errors as of the function `dense`."""
        count = len(out)
        no_map = KernelMap(_NOTHING, _NOTHING, _NOTHING.reshape(0, 1), tile_size(count, self.workers), 0, count, 0)
        return self._add(features, no_map, _NO_WEIGHTS, out, None, (features, weights), relu)

    def run(self) -> None:
        """Compute all layers that were added, and forget them."""
        rows, self._rows = self._rows, []
        if rows:
            layers, progress = np.array(rows, np.int64), aligned_empty((len(rows), 2, 8), np.int64)
            progress[:] = 0
            self.workers.each(lambda _: run_layers(layers, progress), self.workers.threads)
        self._arrays = []

    def _add(
        self,
        features: NDArray[np.float32],
        kernel_map: KernelMap,
        weights: Packed,
        out: NDArray[np.float32],
        residual: NDArray[np.float32] | None,
        shortcut: tuple[NDArray[np.float32], Packed] | None,
        relu: bool,
    ) -> NDArray[np.float32]:
        count, columns = kernel_map.count_out, out.shape[-1] if out.ndim else 0
        _check(out, count, columns, "out")
        if residual is not None:
            _check(residual, count, columns, "residual")
        side, side_weights, bias = out, _NO_WEIGHTS, weights.bias
        if shortcut is not None:
            side, side_weights = shortcut
            _check(side, count, side_weights.rows, "shortcut")
        for one in (weights, side_weights):
            if one.panels.size and one.columns != columns:
                raise ScanError(f"out has {columns} columns, the weights have {one.columns}")
        if shortcut is not None:
            bias = side_weights.bias + (bias if weights.panels.size else np.float32(0))
        panels, tiles = columns // LANES, max(1, -(-count // kernel_map.tile))
        enough = -(-_TASKS_PER_THREAD * self.workers.threads // tiles)
        values = {
            "source": address(features), "row_length": _row_length(features),
            "weights": address(weights.panels), "depth": weights.rows,
            "panels": panels, "offsets": len(weights.panels),
            "inputs": address(kernel_map.inputs), "outputs": address(kernel_map.outputs),
            "starts": address(kernel_map.starts),
            "side": address(side), "side_length": _row_length(side),
            "side_weights": address(side_weights.panels),
            "side_depth": 0 if shortcut is None else side_weights.rows,
            "bias": address(bias),
            "after": 0 if weights.after is None else address(weights.after),
            "residual": 0 if residual is None else address(residual),
            "residual_length": 0 if residual is None else _row_length(residual),
            "out": address(out), "out_length": _row_length(out), "relu": int(relu),
            "tile": kernel_map.tile, "count": count, "blocks": max(1, min(panels, enough)),
        }  # fmt: skip
        self._rows.append([values[name] for name in FIELDS])
        self._arrays.append((features, weights, kernel_map, side, side_weights, bias, residual, out))
        return out


_NOTHING = np.zeros(0, np.int32)
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
    `shortcut`: features (V_out, c) and the weights of a dense layer, added before ReLU. Weights with an `after` pass
    their sums through LeakyReLU, scale and shift before the residual is added. `out` may be the
    residual, but none of the other inputs. Returns `out`. Raises ScanError where an array does not fit, and where the
    map names rows that there are not: the engines, which make their maps themselves, use `Layers`.
    """
    check_map(kernel_map)
    layers = Layers(workers)
    layers.convolve(features, kernel_map, weights, out, residual=residual, shortcut=shortcut, relu=relu)
    layers.run()
    return out


def dense(
    features: NDArray[np.float32], weights: Packed, out: NDArray[np.float32], workers: Workers
) -> NDArray[np.float32]:
    """`out = relu(features @ W + bias)` row by row; arrays as in `convolve`."""
    layers = Layers(workers)
    layers.dense(features, weights, out)
    layers.run()
    return out


def _check(array: NDArray[np.float32], count: int, columns: int, name: str) -> None:
    rows_are_whole = array.size == 0 or array.strides[-1:] == (array.itemsize,)
    if array.dtype != np.float32 or array.shape != (count, columns) or not rows_are_whole:
        raise ScanError(
            f"{name} must be a ({count}, {columns}) float32 array with contiguous rows, "
            f"not {array.dtype} {array.shape} with strides {array.strides}"
        )


def _row_length(array: NDArray[np.float32]) -> int:
    return array.strides[0] // array.itemsize

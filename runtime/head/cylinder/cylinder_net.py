"""Cylinder3D (Zhu et al., CVPR 2021) on the processor: points to cells, a U-net over cells, cells back to points."""

from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.view import POINT_CHANNELS, CylinderView
from runtime.classes import CLASSES
from runtime.compute.arena import Arena
from runtime.compute.jit import fast_kernel, kernel
from runtime.compute.workers import Workers
from runtime.errors import InferenceError
from runtime.head.cylinder.cells import STRIDES, CellScale, coarser, kernel_map, meeting, occupied
from runtime.head.cylinder.cylinder_layers import AXES, ORDERS, UP, checked_cylinder, cylinder_layers
from runtime.head.sparse.convolution import Layers, Packed, pack, padded
from runtime.head.sparse.kernel_map import KernelMap
from runtime.image.image_net import Seen

Floats = NDArray[np.float32]

BLOCK = 16_384  # points that go through the dense layers together: what they leave stays in the cache
_GRAIN = 4096  # cells or points per task
_SAME = (1, 1, 1)


class CylinderNet:
    """Points in; probabilities and features of every point out. One call at a time."""

    providers: tuple[str, ...] = ()

    def __init__(
        self, weights: Mapping[str, NDArray[np.generic]], cylinder: CylinderView, width: int, workers: Workers
    ) -> None:
        """weights: of `cylinder_layers(width)`. Raises BundleError where they do not fit."""
        values = checked_cylinder(weights, width)
        self.cylinder, self.width, self.workers = cylinder, width, workers
        self.timing: dict[str, float] = {}  # s spent in each step of the last scan
        self.multiply_adds = 0  # of the last scan, existing pairs only
        self._weights: dict[str, Packed] = {}
        self._work: dict[str, int] = {}  # multiply-adds of a pair
        for layer in cylinder_layers(width):
            found = (values.get(f"{layer.name}.{part}") for part in ("weight", "bias", "after"))
            weight, bias, after = found
            assert weight is not None
            self._weights[layer.name] = pack(weight, bias, layer.inputs, after)
            self._work[layer.name] = sum(layer.inputs) * layer.outputs
        self._classifier = np.ascontiguousarray(values["classifier.weight"].T), values["classifier.bias"]
        self._arena = Arena()
        self._pending = Layers(workers)

    def run(self, image: Floats) -> Seen:
        """What the network says of points, (11, 1, M) f32 as of `runtime.image.cylinder_inputs`.

        Points without a cell get equal probabilities. Raises InferenceError where the image does not fit, or gives
        values that are not finite.
        """
        if image.dtype != np.float32 or image.ndim != 3 or image.shape[:2] != (POINT_CHANNELS + 1, 1):
            raise InferenceError(f"the network takes ({POINT_CHANNELS + 1}, 1, M) float32, not {image.shape}")
        self._arena.next_scan()
        self._pending = Layers(self.workers)  # none is left of a scan that failed
        self.timing, self.multiply_adds = dict.fromkeys(("maps", "points", "cells"), 0.0), 0
        count = image.shape[2]
        rows = self._arena.take("points", (count, padded(POINT_CHANNELS)))
        rows[:, :POINT_CHANNELS] = image[:POINT_CHANNELS, 0].T
        rows[:, POINT_CHANNELS:] = 0
        began = perf_counter()
        numbers = image[POINT_CHANNELS, 0].astype(np.int32)
        finest = occupied(numbers, self.cylinder.cells, self._arena)
        home = self._arena.take("home", (count,), np.int32)
        _rows_of(numbers, finest.rows, home)
        began = self._spent("maps", began)
        probabilities = np.full((len(CLASSES), 1, count), 1 / len(CLASSES), np.float32)
        hidden = np.zeros((count, padded(self.width)), np.float32)
        if len(finest.cells):
            pooled = self._from_points(rows, home, len(finest.cells), hidden)
            self._spent("points", began)
            cells = self._over_cells(pooled, finest)
            began = perf_counter()
            weight, bias = self._classifier
            run = partial(_refine, cells, home, hidden, weight, bias, probabilities[:, 0])
            self.workers.ranges(run, count, _GRAIN)
            self._spent("points", began)
        if not np.isfinite(probabilities).all():
            raise InferenceError(
                "the network gave values that are not finite; the scan holds values far out of its training data "
                "(coordinates not in metres?), or the weights are damaged"
            )
        return Seen(probabilities, hidden[:, : self.width].T[:, None])

    def _from_points(self, rows: Floats, home: NDArray[np.int32], cells: int, hidden: Floats) -> Floats:
        """The features of points, the greatest of each cell (V, 8 c); what refinement takes goes to `hidden`."""
        widths = [self._weights[f"points.{n}"].columns for n in range(4)]
        pooled = self._arena.take("pooled", (cells, widths[-1]))
        pooled[:] = -np.inf
        for first in range(0, len(rows), BLOCK):
            x, part = rows[first : first + BLOCK], slice(first, first + BLOCK)
            for n, width in enumerate(widths):
                x = self._dense(f"points.{n}", x, self._arena.take(f"points{n}", (len(x), width)), relu=n < 3)
            self._dense("refine.points", x, hidden[part], relu=False)
            self._pending.run()
            run = partial(_greatest, x, home[part], pooled)
            self.workers.ranges(run, widths[-1], -(-widths[-1] // self.workers.threads))
        return pooled

    def _over_cells(self, pooled: Floats, finest: CellScale) -> Floats:
        """The U-net: features (V, 8 c) of the cells to what refinement takes of them (V, c)."""
        began = perf_counter()
        scales = [finest]
        for level in range(1, len(STRIDES) + 1):
            scales.append(coarser(scales[-1], level, self._arena))
        maps = [self._within(scale, level) for level, scale in enumerate(scales)]
        down = [self._between(coarse, fine, n, up=False) for n, (fine, coarse) in enumerate(pairwise(scales), 1)]
        up = [self._between(fine, coarse, n, up=True) for n, (fine, coarse) in enumerate(pairwise(scales), 1)]
        began = self._spent("maps", began)
        c = self.width
        x = self._dense("compress", pooled, self._take("compressed", len(pooled), c // 2))
        x = self._asymmetric("context", x, maps[0], c)
        skips = []
        for n, pairs in enumerate(down, 1):
            x = self._asymmetric(f"down{n}.block", x, maps[n - 1], c << n)
            skips.append(x)
            x = self._conv(f"down{n}.pool", x, pairs, self._take(f"pool{n}", pairs.count_out, c << n))
        for n, skip in enumerate(reversed(skips), 1):
            level = len(skips) - n
            count, channels = len(skip), self._weights[f"up{n}.climb"].columns
            a, b = (self._take(f"up_{name}{level}", count, channels) for name in "ab")
            before = self._take(f"before{level}", len(x), channels)
            x = self._conv(f"up{n}.before", x, maps[level + 1]["3x3x3"], before)
            x = self._conv(f"up{n}.climb", x, up[level], a, residual=skip)
            joined = self._take("joined", count, 2 * channels)  # of the last: what its gates weigh, and x itself
            for m, (size, out) in enumerate(zip(UP, (b, a, b if level else joined[:, channels:]), strict=True)):
                x = self._conv(f"up{n}.block.{m}", x, maps[level][size], out)
        gates = [
            self._conv(f"axes.{n}", x, maps[0][size], self._take(f"axis{n}", len(x), 2 * c))
            for n, size in enumerate(AXES)
        ]
        self._pending.run()
        self.workers.ranges(partial(_gate, *gates, x, joined), len(x), _GRAIN)
        out = self._dense("refine.cells", joined, self._take("refined", len(x), c), relu=False)
        self._pending.run()
        self._spent("cells", began)
        return out

    def _asymmetric(self, name: str, x: Floats, maps: Mapping[str, KernelMap], channels: int) -> Floats:
        """Two branches of two flat kernels each, in both orders, and their sum."""
        total: Floats | None = None
        for branch, (first, second) in enumerate(ORDERS):
            inner, out = (self._take(f"{name}.{branch}.{n}", len(x), channels) for n in range(2))
            y = self._conv(f"{name}.{branch}.0", x, maps[first], inner)
            total = self._conv(f"{name}.{branch}.1", y, maps[second], out, residual=total)
        assert total is not None
        return total

    def _within(self, scale: CellScale, level: int) -> dict[str, KernelMap]:
        """The kernel maps within a scale."""
        arena, count = self._arena, len(scale.cells)
        table = meeting(scale, scale, _SAME, False, arena, self.workers, "table")
        kernels = ("3x3x3", "1x3x3", "3x1x3", *(AXES if level == 0 else ()))
        return {name: kernel_map(table, name, count, arena, self.workers, f"{name}{level}") for name in kernels}

    def _between(self, out: CellScale, inputs: CellScale, level: int, up: bool) -> KernelMap:
        """The kernel map from one scale to the next, which is number `level`, or back."""
        table = meeting(out, inputs, STRIDES[level - 1], up, self._arena, self.workers, "table")
        name = f"{'up' if up else 'down'}{level}"
        return kernel_map(table, "3x3x3", len(inputs.cells), self._arena, self.workers, name)

    def _conv(self, name: str, x: Floats, pairs: KernelMap, out: Floats, residual: Floats | None = None) -> Floats:
        self.multiply_adds += pairs.pairs * self._work[name]
        return self._pending.convolve(x, pairs, self._weights[name], out, residual=residual, relu=False)

    def _dense(self, name: str, x: Floats, out: Floats, relu: bool = True) -> Floats:
        self.multiply_adds += len(x) * self._work[name]
        return self._pending.dense(x, self._weights[name], out, relu)

    def _take(self, name: str, count: int, channels: int) -> Floats:
        return self._arena.take(name, (count, padded(channels)))

    def _spent(self, step: str, began: float) -> float:
        now = perf_counter()
        self.timing[step] += now - began
        return now


@kernel
def _rows_of(numbers, rows, home):  # type: ignore[no-untyped-def]
    """Row of the cell of each point, -1: none."""
    for i in range(numbers.size):
        home[i] = rows[numbers[i]] if 0 <= numbers[i] < rows.size else -1


@fast_kernel
def _greatest(features, home, pooled, first, last):  # type: ignore[no-untyped-def]
    """The greatest value of each cell, of the channels from `first` on."""
    for i in range(home.size):
        row = home[i]
        if row >= 0:
            for channel in range(first, last):
                pooled[row, channel] = max(pooled[row, channel], features[i, channel])


@fast_kernel
def _gate(a, b, c, x, joined, start, stop):  # type: ignore[no-untyped-def]
    """x times the sum of three sigmoids, into the left half of `joined`."""
    one = np.float32(1)
    for i in range(start, stop):
        for channel in range(x.shape[1]):
            gate = one / (one + np.exp(-a[i, channel]))
            gate += one / (one + np.exp(-b[i, channel]))
            gate += one / (one + np.exp(-c[i, channel]))
            joined[i, channel] = gate * x[i, channel]


@fast_kernel
def _refine(cells, home, hidden, weight, bias, probabilities, start, stop):  # type: ignore[no-untyped-def]
    """Adds to `hidden` what the cell of each point says, with ReLU, and classifies it; probabilities (3, M)."""
    zero = np.float32(0)
    for i in range(start, stop):
        row = home[i]
        if row < 0:
            hidden[i] = zero
            continue
        for channel in range(hidden.shape[1]):
            value = hidden[i, channel] + cells[row, channel]
            hidden[i, channel] = zero if value < zero else value  # NaN stays NaN
        scores = bias.copy()
        for k in range(weight.shape[0]):
            for channel in range(weight.shape[1]):
                scores[k] += weight[k, channel] * hidden[i, channel]
        top = max(scores[0], max(scores[1], scores[2]))
        total = zero
        for k in range(weight.shape[0]):
            scores[k] = np.exp(scores[k] - top)
            total += scores[k]
        for k in range(weight.shape[0]):
            probabilities[k, i] = scores[k] / total

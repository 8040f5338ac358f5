"""The point head on a CPU: a sparse U-net over voxels with a point branch (paper, Sec. III-D)."""

from collections.abc import Mapping
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.head_shape import PointHeadConfig
from runtime.compute.workers import Workers
from runtime.head.refinement import Floats, PointHead
from runtime.head.sparse.convolution import Layers, Packed, pack, padded
from runtime.head.sparse.kernel_map import KernelMap, Scale, build_scales, neighbours, table_map, up_map
from runtime.head.transfer import FeatureMap, classify, exchange
from runtime.head.weights import checked, layers

__all__ = ["FeatureMap", "PointHeadEngine"]


class _Maps(NamedTuple):
    """What the convolutions and transfers of one scan share; index 0 is stride 1."""

    scales: list[Scale]
    tables: list[NDArray[np.int32]]  # neighbours
    same: list[KernelMap]  # 3x3x3 within a scale
    down: list[KernelMap]  # down[l]: from scale l to l + 1
    up: list[KernelMap]  # up[l]: from scale l + 1 to l
    members: list[NDArray[np.int32]]  # first voxel of stride 1 of each voxel


class PointHeadEngine(PointHead):
    """The engine of the processor: sorted voxel keys, kernel maps, and convolutions that read their rows in place."""

    def __init__(self, weights: Mapping[str, NDArray[np.generic]], config: PointHeadConfig, workers: Workers) -> None:
        """`weights`: of `layers`, float16 or float32. Raises BundleError where they do not fit."""
        super().__init__(config, workers, padded(config.in_channels))
        values = checked(weights, config)
        self._weights: dict[str, tuple[Packed, int]] = {}  # and the multiply-adds of a pair
        for layer in layers(config):
            weight, bias = values[f"{layer.name}.weight"], values.get(f"{layer.name}.bias")
            self._weights[layer.name] = pack(weight, bias, layer.inputs), sum(layer.inputs) * layer.outputs
        self._classifier = np.ascontiguousarray(values["classifier.weight"].T), values["classifier.bias"]

    def _network(self, keys: NDArray[np.int64], x: Floats) -> Floats:
        config, depth, take = self.config, len(self.config.down), self._take
        self._pending = Layers(self.workers)  # what no result was asked of yet; none is left of a scan that failed
        began = perf_counter()
        maps = self._maps(keys)
        self._spent("maps", began)
        sizes = [len(scale.keys) for scale in maps.scales]

        # Each skip lies in the right-hand columns of the array that its decoder stage reads.
        ups = [padded(channels) for channels in config.up[::-1]]
        joined = [
            take("joined", level, sizes, ups[level] + padded(channels))
            for level, channels in enumerate((config.in_channels, *config.down[:-1]))
        ]
        skips = [joined[level][:, ups[level] :] for level in range(depth)]
        x = self._conv("stem", x, maps.same[0], skips[0])
        for i, channels in enumerate(config.down, 1):
            x = self._conv(f"stage{i}.0", x, maps.down[i - 1], take("a", i, sizes, x.shape[1]))
            x = self._residual(f"stage{i}.1", x, maps.same[i], take("b", i, sizes, channels))
            x = self._residual(f"stage{i}.2", x, maps.same[i], skips[i] if i < depth else take("a", i, sizes, channels))
        points = self._points(0, skips[0], take("points0", 0, sizes, config.down[-1]))
        x = self._exchange(x, depth, maps, points)
        for i, channels in enumerate(config.up, 1):
            level = depth - i
            self._conv(f"up{i}.0", x, maps.up[level], joined[level][:, : ups[level]])
            x = self._residual(f"up{i}.1.0", joined[level], maps.same[level], take("a", level, sizes, channels))
            x = self._residual(f"up{i}.1.1", x, maps.same[level], take("b", level, sizes, channels))
            if i == config.fuse_after_up:
                points = self._points(1, points, take("points1", 0, sizes, channels))
                x = self._exchange(x, level, maps, points)
        last = 1 if config.fuse_after_up is None else 2
        points = self._points(last, points, take("inner", 0, sizes, config.up[-1]))
        began = self._run()
        weight, bias = self._classifier
        result = classify(points, x, weight, bias, self._arena.take("result", (sizes[0], 3)), self.workers)
        self._spent("transfers", began)
        return result

    def _maps(self, keys: NDArray[np.int64]) -> _Maps:
        """Everything about who meets whom."""
        depth, arena, workers = len(self.config.down), self._arena, self.workers
        scales = build_scales(keys, depth, arena)
        tables = neighbours(scales, 0, arena, workers)
        sizes = [len(scale.keys) for scale in scales]
        same = [table_map(tables[i], sizes[i], arena, workers, f"same{i}") for i in range(depth + 1)]
        down = [table_map(scales[i + 1].child, sizes[i], arena, workers, f"down{i}") for i in range(depth)]
        up = [up_map(scales[i], sizes[i + 1], arena, workers, f"up{i}") for i in range(depth)]
        members = [np.arange(sizes[0] + 1, dtype=np.int32)]
        for i in range(1, depth + 1):
            members.append(members[-1][scales[i].starts])
        return _Maps(scales, tables, same, down, up, members)

    def _conv(
        self,
        name: str,
        x: Floats,
        kernel_map: KernelMap,
        out: Floats,
        residual: Floats | None = None,
        shortcut: tuple[Floats, Packed] | None = None,
    ) -> Floats:
        weights, work = self._weights[name]
        self.multiply_adds += kernel_map.pairs * work
        return self._pending.convolve(x, kernel_map, weights, out, residual=residual, shortcut=shortcut)

    def _residual(self, name: str, x: Floats, kernel_map: KernelMap, out: Floats) -> Floats:
        """ReLU(conv2(ReLU(conv1(x))) + x), or + shortcut(x) where the widths differ."""
        inner = self._take("inner", 0, [kernel_map.count_out], out.shape[1])
        self._conv(f"{name}.conv1", x, kernel_map, inner)
        if f"{name}.shortcut" not in self._weights:
            return self._conv(f"{name}.conv2", inner, kernel_map, out, residual=x)
        weights, work = self._weights[f"{name}.shortcut"]
        self.multiply_adds += kernel_map.count_out * work
        return self._conv(f"{name}.conv2", inner, kernel_map, out, shortcut=(x, weights))

    def _points(self, i: int, points: Floats, out: Floats) -> Floats:
        """A dense layer of the point branch."""
        weights, work = self._weights[f"point_transforms.{i}"]
        self.multiply_adds += len(points) * work
        return self._pending.dense(points, weights, out)

    def _run(self) -> float:
        """Compute what is pending; the time when that is done."""
        began = perf_counter()
        self._pending.run()
        return self._spent("convolutions", began)

    def _exchange(self, x: Floats, level: int, maps: _Maps, points: Floats) -> Floats:
        """Voxels of stride 2^level and points exchange what they have."""
        began = self._run()
        out = self._take("exchanged", 0, [len(x)], x.shape[1])
        exchange(x, maps.tables[level], maps.members[level], maps.scales[0].keys, level, points, out, self.workers)
        self._spent("transfers", began)
        return out

    def _take(self, name: str, level: int, sizes: list[int], channels: int) -> Floats:
        """A workspace with a row for each voxel of a scale."""
        return self._arena.take(f"{name}{level}", (sizes[level], padded(channels)))

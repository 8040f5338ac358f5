"""The point head on a CPU: a sparse U-net over voxels with a point branch (paper, Sec. III-D)."""

import threading
from collections.abc import Mapping
from math import ceil
from time import perf_counter
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.arena import Arena
from runtime.errors import InferenceError, ScanError, SettingError
from runtime.head_config import PointHeadConfig
from runtime.head_weights import checked, fold, layers
from runtime.kernel_map import KernelMap, Scale, build_scales, neighbours, table_map, up_map
from runtime.region import receptive_field, surroundings
from runtime.sparse_conv import Packed, convolve, dense, pack, padded
from runtime.transfer import classify, exchange, features_to_voxels, to_points
from runtime.voxels import Voxels, voxelise
from runtime.workers import Workers

__all__ = ["DEFAULT_HALO", "FeatureMap", "PointHeadEngine", "fold"]

DEFAULT_HALO = 1.0  # m around candidates

Floats = NDArray[np.float32]


class FeatureMap(NamedTuple):
    """Features of an image and the pixel of each point; only the voxels that are refined read theirs."""

    features: Floats  # (c, H, W)
    u: NDArray[np.int32]  # (N,) column, negative: no pixel (features are 0)
    v: NDArray[np.int32]  # (N,) row


class _Maps(NamedTuple):
    """What the convolutions and transfers of one scan share; index 0 is stride 1."""

    scales: list[Scale]
    tables: list[NDArray[np.int32]]  # neighbours
    same: list[KernelMap]  # 3x3x3 within a scale
    down: list[KernelMap]  # down[l]: from scale l to l + 1
    up: list[KernelMap]  # up[l]: from scale l + 1 to l
    members: list[NDArray[np.int32]]  # first voxel of stride 1 of each voxel


class PointHeadEngine:
    """Refines coarse results. One call at a time (others wait); workspaces are reused from scan to scan."""

    def __init__(self, weights: Mapping[str, NDArray[np.generic]], config: PointHeadConfig, workers: Workers) -> None:
        """`weights`: as `fold` returns them, float16 or float32. Raises BundleError where they do not fit."""
        self.config, self.workers = config, workers
        self.timing: dict[str, float] = {}  # s spent in each step of the last scan
        self.multiply_adds = 0  # of the last scan's convolutions and dense layers, existing pairs only
        self.voxels = 0  # voxels refined in the last scan
        self._arena = Arena()
        self._lock = threading.Lock()
        values = checked(weights, config)
        self._layers: dict[str, tuple[Packed, int]] = {}  # weights, multiply-adds of a pair
        for layer in layers(config):
            weight, bias = values[f"{layer.name}.weight"], values.get(f"{layer.name}.bias")
            self._layers[layer.name] = pack(weight, bias, layer.inputs), sum(layer.inputs) * layer.outputs
        self._classifier = np.ascontiguousarray(values["classifier.weight"].T), values["classifier.bias"]

    def refine(
        self,
        xyz: Floats,
        valid: NDArray[np.bool_],
        pixel_features: Floats | FeatureMap | tuple[Floats, NDArray[np.int32], NDArray[np.int32]],
        candidates: NDArray[np.bool_] | None = None,
        halo: float | Literal["exact"] = DEFAULT_HALO,
    ) -> Floats:
        """Class probabilities (N, 3) of a scan's points; NaN for points that were not refined.

        `xyz` (N, 3) m, LiDAR frame; `valid` (N,) points that take part (those with NaN or infinity never do);
        `pixel_features` (N, c), or a FeatureMap. `candidates` (N,): refine these only, looking only at voxels
        within `halo` m of theirs (on each axis); "exact" is wide enough for the result of a full run. None:
        refine all valid points. Raises ScanError for shapes that do not fit and scans that span 2^21 voxels,
        InferenceError where the features are not finite.
        """
        with self._lock:
            self.timing = dict.fromkeys(("voxels", "maps", "transfers", "convolutions"), 0.0)
            self.multiply_adds = self.voxels = 0
            count = len(xyz)
            features, rows = self._features(pixel_features, count)
            result = np.full((count, 3), np.nan, np.float32)
            wanted = np.ones(count, np.bool_) if candidates is None else np.require(candidates, np.bool_, ["C", "W"])
            if wanted.shape != (count,):
                raise ScanError(f"the mask of candidates must be ({count},), not {wanted.shape}")
            reach = self._reach(halo)
            if not wanted.any():
                return result
            began = perf_counter()
            voxels = voxelise(xyz, self.config.voxel_size, self.workers, valid)
            kept = (
                self._kept(voxels, wanted, reach)
                if candidates is not None
                else np.arange(len(voxels.keys), dtype=np.int32)
            )
            self._spent("voxels", began)
            if len(kept):
                probabilities = self._network(voxels, kept, features, rows)
                if not np.isfinite(probabilities).all():
                    raise InferenceError("the point head's result is not finite: look for NaN in the features")
                began = perf_counter()
                place = np.full(len(voxels.keys), -1, np.int32)
                place[kept] = np.arange(len(kept), dtype=np.int32)
                to_points(probabilities, place, voxels.inverse, wanted, result)
                self._spent("transfers", began)
            return result

    @property
    def workspace(self) -> int:
        """Bytes held from scan to scan."""
        return self._arena.nbytes

    def _reach(self, halo: float | Literal["exact"]) -> int:
        """Voxels around candidates."""
        if halo == "exact":
            return receptive_field(self.config)
        if not isinstance(halo, int | float) or not 0 <= halo < float("inf"):
            raise SettingError(f'halo must be "exact" or a distance of 0 m or more, not {halo!r}')
        return ceil(halo / self.config.voxel_size - 1e-6)

    def _features(
        self, given: Floats | FeatureMap | tuple[Floats, NDArray[np.int32], NDArray[np.int32]], count: int
    ) -> tuple[Floats, NDArray[np.int32]]:
        """Features as (R, c), in any memory order, and the row of each point."""
        if isinstance(given, tuple):
            image, u, v = given
            channels, _, width = image.shape
            if channels == self.config.in_channels and np.shape(u) == np.shape(v) == (count,):
                image = np.require(image, np.float32, ["C", "W"]).reshape(channels, -1).T
                return image, np.where(u >= 0, v * np.int32(width) + u, np.int32(-1)).astype(np.int32)
            shapes = f"{given[0].shape}, {np.shape(u)} and {np.shape(v)}"
        elif given.shape == (count, self.config.in_channels):
            return np.require(given, np.float32, ["C", "W"]), np.arange(count, dtype=np.int32)
        else:
            shapes = str(given.shape)
        channels = self.config.in_channels
        raise ScanError(
            f"features of {count} points must be ({count}, {channels}), or ({channels}, H, W) with two "
            f"({count},) arrays of pixels, not {shapes}"
        )

    def _kept(self, voxels: Voxels, wanted: NDArray[np.bool_], reach: int) -> NDArray[np.int32]:
        """Rows of the voxels to look at."""
        candidates = np.zeros(len(voxels.keys), np.bool_)
        candidates[voxels.inverse[wanted & (voxels.inverse >= 0)]] = True
        if not candidates.any():
            return np.zeros(0, np.int32)
        return surroundings(voxels.keys, candidates, reach, self._arena, self.workers)

    def _network(self, voxels: Voxels, kept: NDArray[np.int32], features: Floats, rows: NDArray[np.int32]) -> Floats:
        """Class probabilities (K, 3) of the voxels `kept` (K,)."""
        config, depth, take = self.config, len(self.config.down), self._take
        began = perf_counter()
        maps = self._maps(voxels.keys[kept] if len(kept) < len(voxels.keys) else voxels.keys)
        began = self._spent("maps", began)
        sizes = [len(scale.keys) for scale in maps.scales]
        self.voxels = sizes[0]
        x = take("features", 0, sizes, config.in_channels)
        features_to_voxels(features, rows, voxels, kept, config.reduce == "mean", x, self.workers)
        self._spent("transfers", began)

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
        began = perf_counter()
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
        began = perf_counter()
        weights, work = self._layers[name]
        self.multiply_adds += kernel_map.pairs * work
        convolve(x, kernel_map, weights, out, self.workers, residual=residual, shortcut=shortcut)
        self._spent("convolutions", began)
        return out

    def _residual(self, name: str, x: Floats, kernel_map: KernelMap, out: Floats) -> Floats:
        """ReLU(conv2(ReLU(conv1(x))) + x), or + shortcut(x) where the widths differ."""
        inner = self._take("inner", 0, [kernel_map.count_out], out.shape[1])
        self._conv(f"{name}.conv1", x, kernel_map, inner)
        if f"{name}.shortcut" not in self._layers:
            return self._conv(f"{name}.conv2", inner, kernel_map, out, residual=x)
        weights, work = self._layers[f"{name}.shortcut"]
        self.multiply_adds += kernel_map.count_out * work
        return self._conv(f"{name}.conv2", inner, kernel_map, out, shortcut=(x, weights))

    def _points(self, i: int, points: Floats, out: Floats) -> Floats:
        """A dense layer of the point branch."""
        began = perf_counter()
        weights, work = self._layers[f"point_transforms.{i}"]
        self.multiply_adds += len(points) * work
        dense(points, weights, out, self.workers)
        self._spent("convolutions", began)
        return out

    def _exchange(self, x: Floats, level: int, maps: _Maps, points: Floats) -> Floats:
        """Voxels of stride 2^level and points exchange what they have."""
        began = perf_counter()
        out = self._take("exchanged", 0, [len(x)], x.shape[1])
        exchange(x, maps.tables[level], maps.members[level], maps.scales[0].keys, level, points, out, self.workers)
        self._spent("transfers", began)
        return out

    def _take(self, name: str, level: int, sizes: list[int], channels: int) -> Floats:
        """A workspace with a row for each voxel of a scale."""
        return self._arena.take(f"{name}{level}", (sizes[level], padded(channels)))

    def _spent(self, step: str, began: float) -> float:
        now = perf_counter()
        self.timing[step] += now - began
        return now

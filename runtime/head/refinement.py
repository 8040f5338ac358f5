"""What every engine of the point head has in common: which points of a scan are refined, and how they are asked for."""

from abc import ABC, abstractmethod
from math import ceil
from time import perf_counter
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.head_shape import PointHeadConfig, receptive_field
from runtime.bundle.manifest import Tuned
from runtime.compute.arena import Arena
from runtime.compute.turns import Turns
from runtime.compute.workers import Workers
from runtime.errors import InferenceError, ScanError, SettingError
from runtime.head.transfer import FeatureMap, features_to_voxels, to_points
from runtime.head.voxels import BLOCK, voxelise

WARM_UP = 200  # points a side of the wall that is refined at the start: more voxels than most scans have near movers

Floats = NDArray[np.float32]


class PointHead(ABC):
    """Refines coarse results. One call at a time (others wait); workspaces are reused from scan to scan."""

    def __init__(self, config: PointHeadConfig, workers: Workers, width: int) -> None:
        """width: of the features that `_network` takes; those beyond `config.in_channels` are 0."""
        self.config, self.workers, self._width = config, workers, width
        self.timing: dict[str, float] = {}  # s spent in each step of the last scan
        self.multiply_adds = 0  # of the last scan, existing pairs only; 0 from engines that do not count
        self.voxels = 0  # voxels refined in the last scan
        self._step = 1 if config.reduce == "first" else 1 << max(len(config.down), BLOCK)  # of the grid, in voxels
        self._arena = Arena()
        self._turns = Turns()

    def refine(
        self,
        xyz: Floats,
        valid: NDArray[np.bool_],
        pixel_features: Floats | FeatureMap,
        candidates: NDArray[np.bool_] | None = None,
        halo: float | Literal["exact"] = Tuned.halo,
    ) -> Floats:
        """Class probabilities (N, 3) of a scan's points; NaN for points that were not refined.

        `xyz` (N, 3) m, LiDAR frame; `valid` (N,) points that take part, all of them finite;
        `pixel_features` (N, c), or a FeatureMap. `candidates` (N,): refine these only, looking at the voxels within
        `halo` m of theirs (on each axis), and at the rest of the blocks of 4^3 voxels that these lie in; "exact" is
        wide enough for the result of a full run. None: refine all valid points. Raises ScanError for shapes that do
        not fit and scans that span 2^21 voxels, SettingError for another halo, InferenceError where the features are
        not finite.
        """
        with self._turns.alone():
            self._arena.next_scan()
            self.timing = dict.fromkeys(("voxels", "maps", "transfers", "convolutions"), 0.0)
            self.multiply_adds = self.voxels = 0
            count = len(xyz)
            features = self._features(pixel_features, count)
            result = np.full((count, 3), np.nan, np.float32)
            wanted = np.ones(count, np.bool_) if candidates is None else np.require(candidates, np.bool_, ["C", "W"])
            if wanted.shape != (count,):
                raise ScanError(f"the mask of candidates must be ({count},), not {wanted.shape}")
            reach = self._reach(halo)
            if not wanted.any():
                return result
            began = perf_counter()
            near = None if candidates is None else (wanted, reach)
            voxels = voxelise(xyz, self.config.voxel_size, self.workers, valid, near, self._step)
            began = self._spent("voxels", began)
            self.voxels = len(voxels.keys)
            if not self.voxels:
                return result
            x = self._arena.take("features", (self.voxels, self._width))
            features_to_voxels(features, voxels, self.config.reduce == "mean", x, self.workers)
            self._spent("transfers", began)
            probabilities = self._network(voxels.keys, x)
            if not np.isfinite(probabilities).all():
                raise InferenceError("the point head's result is not finite: look for NaN in the features")
            began = perf_counter()
            to_points(probabilities, voxels.order, voxels.starts, wanted, result)
            self._spent("transfers", began)
            return result

    def warm_up(self) -> None:
        """Refine a wall, near a point of it and as a whole: compiles every kernel and lays out memory."""
        grid = 1.01 * self.config.voxel_size * np.arange(WARM_UP, dtype=np.float32)
        y, z = (a.reshape(-1) for a in np.meshgrid(grid, grid))
        wall = np.stack([np.full_like(y, 10), y, z, y], axis=1)[:, :3]  # as a scan's: its kernels are those of columns
        features = FeatureMap(np.zeros((self.config.in_channels, 1, 2), np.float32), np.zeros(len(y), np.int32), 2)
        valid = np.ones(len(y), np.bool_)
        self.refine(wall, valid, features, np.arange(len(y)) == 0)
        self.refine(wall, valid, features)

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

    def _features(self, given: Floats | FeatureMap, count: int) -> FeatureMap:
        """The features of `count` points, checked."""
        channels = self.config.in_channels
        if isinstance(given, FeatureMap):
            image, pixel, width = given
            fits = image.ndim == 3 and len(image) == channels and image.size > 0 and width % image.shape[2] == 0
            if fits and pixel.shape == (count,) and pixel.dtype == np.int32:
                return FeatureMap(np.require(image, np.float32, ["C", "W"]), pixel, width)
            shapes = f"{image.shape} of an image {width} wide, with {pixel.shape} {pixel.dtype} pixels"
        elif given.shape == (count, channels):
            image = np.require(given, np.float32, ["C", "W"]).T[:, None]
            return FeatureMap(image, np.arange(count, dtype=np.int32), count)
        else:
            shapes = str(given.shape)
        raise ScanError(
            f"features of {count} points must be ({count}, {channels}), or a FeatureMap of ({channels}, H, W / s) with "
            f"({count},) int32 pixels, not {shapes}"
        )

    @abstractmethod
    def _network(self, keys: NDArray[np.int64], x: Floats) -> Floats:
        """Class probabilities (V, 3) of the voxels `keys` (V,) with features `x` (V, width)."""

    def _spent(self, step: str, began: float) -> float:
        now = perf_counter()
        self.timing[step] += now - began
        return now

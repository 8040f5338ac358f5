"""What every engine of the point head has in common: which points of a scan are refined, and how they are asked for."""

import threading
from abc import ABC, abstractmethod
from math import ceil
from time import perf_counter
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.arena import Arena
from runtime.errors import InferenceError, ScanError, SettingError
from runtime.head_config import PointHeadConfig
from runtime.region import receptive_field, surroundings
from runtime.transfer import to_points
from runtime.voxels import Voxels, voxelise
from runtime.workers import Workers

DEFAULT_HALO = 0.4  # m around candidates: with trained weights as good as 1 m, at half the voxels

Floats = NDArray[np.float32]


class FeatureMap(NamedTuple):
    """Features of an image and the pixel of each point; only the voxels that are refined read theirs."""

    features: Floats  # (c, H, W / s): s neighbouring pixels of a row share theirs
    pixel: NDArray[np.int32]  # (N,) v * W + u of each point, negative: no pixel (features are 0)
    width: int  # W


class PointHead(ABC):
    """Refines coarse results. One call at a time (others wait); workspaces are reused from scan to scan."""

    def __init__(self, config: PointHeadConfig, workers: Workers) -> None:
        self.config, self.workers = config, workers
        self.timing: dict[str, float] = {}  # s spent in each step of the last scan
        self.multiply_adds = 0  # of the last scan, existing pairs only; 0 from engines that do not count
        self.voxels = 0  # voxels refined in the last scan
        self._arena = Arena()
        self._lock = threading.Lock()

    def refine(
        self,
        xyz: Floats,
        valid: NDArray[np.bool_],
        pixel_features: Floats | FeatureMap,
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
            near = None if candidates is None else (wanted, reach)
            voxels = voxelise(xyz, self.config.voxel_size, self.workers, valid, near)
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

    def _features(self, given: Floats | FeatureMap, count: int) -> tuple[Floats, NDArray[np.int32]]:
        """Features as (R, c), in any memory order, and the row of each point, negative for zeros."""
        channels = self.config.in_channels
        if isinstance(given, FeatureMap):
            image, pixel, width = given
            if image.shape[0] == channels and pixel.shape == (count,) and width % image.shape[2] == 0:
                image = np.require(image, np.float32, ["C", "W"]).reshape(channels, -1).T
                share = width // given.features.shape[2]
                return image, pixel if share == 1 else pixel // np.int32(share)  # -1 // share is -1
            shapes = f"{image.shape} of an image {width} wide, with {pixel.shape} pixels"
        elif given.shape == (count, channels):
            return np.require(given, np.float32, ["C", "W"]), np.arange(count, dtype=np.int32)
        else:
            shapes = str(given.shape)
        raise ScanError(
            f"features of {count} points must be ({count}, {channels}), or a FeatureMap of ({channels}, H, W / s) with "
            f"({count},) pixels, not {shapes}"
        )

    def _kept(self, voxels: Voxels, wanted: NDArray[np.bool_], reach: int) -> NDArray[np.int32]:
        """Rows of the voxels to look at."""
        candidates = np.zeros(len(voxels.keys), np.bool_)
        candidates[voxels.inverse[wanted & (voxels.inverse >= 0)]] = True
        if not candidates.any():
            return np.zeros(0, np.int32)
        return surroundings(voxels.keys, candidates, reach, self._arena, self.workers)

    @abstractmethod
    def _network(self, voxels: Voxels, kept: NDArray[np.int32], features: Floats, rows: NDArray[np.int32]) -> Floats:
        """Class probabilities (K, 3) of the voxels `kept` (K,); features and rows as `_features` returns them."""

    def _spent(self, step: str, began: float) -> float:
        now = perf_counter()
        self.timing[step] += now - began
        return now

"""The point head on ONNX Runtime: the same network as a graph over neighbour tables, for GPU providers.

The tables come from the kernels of `runtime.head.sparse.kernel_map`; V_L are the voxels of stride 2^L, V_0 the points.
A row number that equals the number of rows stands for a voxel that is missing. Inputs of the graph
(`export/graph/head_graph.py`):

    features (V_0, c) f32       of each voxel
    neighboursL (V_L, 27) i32   x fastest, then y, then z; the middle column is the voxel itself
    childrenL (V_L, 8) i32      its finer voxels by octant, z fastest; from L = 1 on
    placeL (V_L,) i32           8 * row of its coarser voxel + its octant there; but for the coarsest
    for each L at which the point branch joins (`joins`):
    cornersL (V_0, 8) i32       voxels of stride 2^L around a point, z fastest
    nearnessL (V_0, 8) f32      their shares in the point's value, sum 1
    shareL (V_L, 1) f32         1 / number of its points

CUDA's provider computes products in TF32 where the GPU has it; ("CUDAExecutionProvider", {"use_tf32": "0"}) keeps them
in float32.
"""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.loading import Bundle
from runtime.bundle.manifest import POINT_HEAD_ONNX
from runtime.classes import CLASSES
from runtime.compute.sessions import ON_CPU, Execution, open_session, provider_name
from runtime.compute.workers import Workers
from runtime.errors import BundleError, InferenceError, SettingError
from runtime.head.numba_engine import PointHeadEngine
from runtime.head.refinement import Floats, PointHead
from runtime.head.sparse.kernel_map import Scale, build_scales, neighbours
from runtime.settings import CHOICES

# Providers that take a graph as it is; others compile it anew for every number of voxels, or run on the processor.
GPU = ("CUDAExecutionProvider", "ROCMExecutionProvider", "DmlExecutionProvider")

_OCTANTS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_AHEAD = 13 + _OCTANTS @ (1, 3, 9)  # columns of a neighbour table: the voxels at offsets 0 or 1 on each axis


def joins(config: PointHeadConfig) -> list[int]:
    """The scales L (stride 2^L) at which voxels and points exchange what they have, in the order of the network."""
    depth = len(config.down)
    return [depth] if config.fuse_after_up is None else [depth, depth - config.fuse_after_up]


class OnnxHead(PointHead):
    """The engine of other execution providers; `refine` as that of `PointHeadEngine`."""

    def __init__(
        self,
        path: str | Path,
        config: PointHeadConfig,
        workers: Workers,
        execution: Execution = ON_CPU,
    ) -> None:
        """`path`: a bundle's `point_head.onnx`. Raises BundleError where it does not fit `config`, and what
        `runtime.compute.sessions.open_session` does."""
        super().__init__(config, workers, config.in_channels)
        self._session = open_session(path, threads=workers.threads, execution=execution)
        self.providers: list[str] = self._session.get_providers()
        self._path = path
        given = {value.name: value.shape for value in self._session.get_inputs()}
        wanted = _names(config)
        if set(given) != wanted or given["features"][1:] != [config.in_channels]:
            raise BundleError(
                f"{path}: is not the graph of this point head: inputs {sorted(given)}, not {sorted(wanted)} with "
                f"{config.in_channels} features"
            )

    def _network(self, keys: NDArray[np.int64], x: Floats) -> Floats:
        began = perf_counter()
        feeds = {**self._tables(keys), "features": x}
        began = self._spent("maps", began)
        try:
            (probabilities,) = self._session.run(["probabilities"], feeds)
        except Exception as error:  # ONNX Runtime's errors share no base but Exception
            raise InferenceError(f"the point head failed: {error}") from error
        self._spent("convolutions", began)
        if probabilities.shape != (len(keys), len(CLASSES)) or probabilities.dtype != np.float32:
            raise BundleError(
                f"{self._path}: gives probabilities of shape {probabilities.shape} {probabilities.dtype}, not "
                f"({len(keys)}, {len(CLASSES)}) float32; get the bundle again"
            )
        result: Floats = probabilities
        return result

    def _tables(self, keys: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """All inputs of the graph but the features."""
        depth = len(self.config.down)
        scales = build_scales(keys, depth, self._arena)
        tables = neighbours(scales, 0, self._arena, self.workers)
        feeds: dict[str, NDArray[Any]] = {f"neighbours{i}": tables[i][:-1] for i in range(depth + 1)}
        members = np.arange(len(keys) + 1, dtype=np.int32)  # first voxel of stride 1 of each voxel
        for level in range(depth):
            fine, coarse = scales[level], scales[level + 1]
            feeds[f"place{level}"] = fine.parent * np.int32(8) + (fine.keys & 7).astype(np.int32)
            feeds[f"children{level + 1}"] = coarse.child[:-1]
            members = members[coarse.starts]
            if level + 1 in joins(self.config):
                feeds.update(_join(scales[0], level + 1, tables[level + 1], members))
        return feeds


def choose_head(
    bundle: Bundle,
    workers: Workers,
    engine: str = "auto",
    execution: Execution = ON_CPU,
) -> PointHead:
    """The point head of a bundle that has one.

    engine: "numba", on the processor; "onnx", by `execution`; "auto": ONNX Runtime on those of its providers that are a
    GPU's, where there are any and the bundle has `point_head.onnx`, else Numba.

    Raises SettingError for an unknown engine, or for "onnx" where the bundle lacks the graph; else as `OnnxHead`.
    """
    config = bundle.manifest.point_head
    there = POINT_HEAD_ONNX in bundle.manifest.files
    if engine not in CHOICES["head_engine"]:
        raise SettingError(
            f"the engine of the point head must be one of {', '.join(CHOICES['head_engine'])}, not {engine!r}"
        )
    if engine == "onnx" and not there:
        raise SettingError(f"{bundle.path}: has no {POINT_HEAD_ONNX}; `mos export --point-head-onnx` makes it")
    if config is None:
        raise SettingError(f"{bundle.path}: has no point head")
    if engine == "auto":
        gpus = [one for one in execution.providers or () if provider_name(one) in GPU]
        execution = replace(execution, providers=gpus)
        engine = "onnx" if gpus and there else "numba"
    if engine == "numba":
        return PointHeadEngine(bundle.point_head(), config, workers)
    return OnnxHead(bundle.path / POINT_HEAD_ONNX, config, workers, execution)


def _names(config: PointHeadConfig) -> set[str]:
    """Inputs of the graph."""
    depth = len(config.down)
    found = {"features", *(f"neighbours{i}" for i in range(depth + 1))}
    for i in range(depth):
        found |= {f"children{i + 1}", f"place{i}"}
    for i in joins(config):
        found |= {f"corners{i}", f"nearness{i}", f"share{i}"}
    return found


def _join(points: Scale, level: int, table: NDArray[np.int32], members: NDArray[np.int32]) -> dict[str, NDArray[Any]]:
    """Corners, nearness and share of a scale; `table` (V + 1, 27) its neighbours, `members` (V + 1,) its points."""
    counts = np.diff(members)
    corners = np.repeat(table[:-1, _AHEAD], counts, axis=0)  # (V_0, 8)
    place = np.zeros((len(points.keys), 3), np.float32)  # in the voxel of this scale, from 0 to below 1
    for bit in range(level):
        octant = points.keys >> 3 * bit
        for axis in range(3):
            place[:, axis] += (octant >> 2 - axis & 1) * np.float32(2.0 ** (bit - level))
    nearness = np.where(_OCTANTS, place[:, None], 1 - place[:, None]).prod(axis=2)  # (V_0, 8)
    nearness *= corners < len(counts)
    nearness /= nearness.sum(axis=1, keepdims=True)
    share = (1 / counts[:, None]).astype(np.float32)
    return {f"corners{level}": corners, f"nearness{level}": nearness, f"share{level}": share}

"""One sparse 3x3x3 layer with its kernel map, beside spconv and plain PyTorch where they are installed.

python -m bench.sparse_layer --sequence ../shared/data/kitti/sequences/00 --out layer.json

`pip install spconv==2.3.8` brings the CPU build of spconv.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import brief, interleaved, save, show, summary
from bench.scans import load_frames, taking_part
from runtime.commands.handler import run_alone
from runtime.compute.arena import Arena
from runtime.compute.workers import Workers
from runtime.head.sparse.convolution import convolve, pack
from runtime.head.sparse.kernel_map import KernelMap, build_scales, neighbours, table_map
from runtime.head.voxels import voxelise

Layer = Callable[[], np.ndarray]
OTHERS = ("PyTorch, map given", "spconv")
TOLERANCE = 1e-3  # largest difference of outputs of about 1


def this_layers(keys: np.ndarray, features: np.ndarray, kernel: np.ndarray, threads: int) -> dict[str, Layer]:
    """Map and convolution, and the convolution alone."""
    workers, arena = Workers(threads), Arena()
    weights, out = pack(kernel), np.empty_like(features)

    def new_map(arena: Arena) -> KernelMap:
        table = neighbours(build_scales(keys, 0, arena), 0, arena, workers)[0]
        return table_map(table, len(keys), arena, workers, "layer")

    def run(kernel_map: KernelMap) -> np.ndarray:
        return convolve(features, kernel_map, weights, out, workers, relu=False)

    given = new_map(Arena())
    return {"this": lambda: run(new_map(arena)), "this, map given": lambda: run(given)}


def torch_layer(keys: np.ndarray, features: np.ndarray, kernel: np.ndarray, threads: int) -> Layer:
    """Gather, matrix product and index_add in PyTorch; the pairs are given."""
    import torch

    torch.set_num_threads(threads)
    table = neighbours(build_scales(keys, 0, Arena()), 0, Arena(), Workers(threads))[0][:-1].T
    found = [np.flatnonzero(column < len(keys)) for column in table]
    pairs = [(torch.from_numpy(c[o].astype(np.int64)), torch.from_numpy(o)) for c, o in zip(table, found, strict=True)]
    x, w = torch.from_numpy(features), torch.from_numpy(kernel)

    def run() -> np.ndarray:
        out = torch.zeros(len(x), w.shape[2])
        for k, (i, o) in enumerate(pairs):
            out.index_add_(0, o, x[i] @ w[k])
        return out.numpy()

    return run


def spconv_layer(coords: np.ndarray, features: np.ndarray, kernel: np.ndarray, threads: int) -> Layer:
    """Map and convolution in spconv's CPU path."""
    import spconv.pytorch as spconv
    import torch

    torch.set_num_threads(threads)
    layer = spconv.SubMConv3d(kernel.shape[1], kernel.shape[2], 3, bias=False, algo=spconv.ConvAlgo.Native)
    weight = kernel.reshape(3, 3, 3, *kernel.shape[1:]).transpose(4, 0, 1, 2, 3)  # out z y x in
    layer.weight.data = torch.from_numpy(np.ascontiguousarray(weight)).reshape(layer.weight.shape)
    batch_z_y_x = np.pad(coords[:, ::-1], ((0, 0), (1, 0))).astype(np.int32)
    indices, shape = torch.from_numpy(np.ascontiguousarray(batch_z_y_x)), (coords.max(axis=0)[::-1] + 1).tolist()

    def run() -> np.ndarray:
        with torch.no_grad():
            found = layer(spconv.SparseConvTensor(torch.from_numpy(features), indices, shape, 1))
        return np.asarray(found.features)

    return run


def compare(keys: np.ndarray, coords: np.ndarray, channels: int, threads: int, rounds: int) -> dict[str, Any]:
    """Times of all that is installed; outputs are compared first, and those that differ are marked.

    spconv 2.3.8 agrees with one thread; with more its sums on a CPU are wrong, and differ from run to run.
    """
    random = np.random.default_rng(1)
    features = random.normal(size=(len(keys), channels)).astype(np.float32)
    kernel = random.normal(0, 0.05, (27, channels, channels)).astype(np.float32)
    tasks = this_layers(keys, features, kernel, threads)
    expected = tasks["this"]().copy()
    rows: dict[str, Any] = {name: {} for name in tasks}
    for name, make, where in zip(OTHERS, (torch_layer, spconv_layer), (keys, coords), strict=True):
        try:
            tasks[name] = make(where, features, kernel, threads)
        except ImportError as error:
            rows[name] = {"note": f"not installed: {error}"}
            continue
        difference = float(np.abs(tasks[name]() - expected).max())
        rows[name] = {"difference": f"{difference:.1e}", "agrees": difference <= TOLERANCE}
    for name, seconds in interleaved(tasks, rounds).items():
        rows[name] = summary(seconds) | rows[name]
        rows[name]["times this"] = float(np.median(seconds)) * 1e3 / rows["this"]["median"]
    return rows


def layers(points: np.ndarray, threads: int, rounds: int) -> dict[str, Any]:
    """32 -> 32 channels at stride 1 and 96 -> 96 at stride 2 of a scan (N, 4)."""
    voxels = voxelise(taking_part(points)[:, :3], 0.05, Workers(threads))
    fine, coarse, *_ = build_scales(voxels.keys, 1, Arena())
    kinds = {
        "32 -> 32 at stride 1": (fine.keys, voxels.coords, 32),
        "96 -> 96 at stride 2": (coarse.keys, voxels.coords[coarse.starts[:-1]] >> 1, 96),
    }
    results = {}
    for name, (keys, coords, channels) in kinds.items():
        results[name] = compare(keys, coords, channels, threads, rounds)
        show(f"{name}, {len(keys)} voxels, map and convolution, ms", brief(results[name]))
    return results


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    threads: int = 2,
    rounds: int = 15,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Two layers of the point head, each beside the other libraries; outputs are compared first."""
    [(points, _)] = load_frames(sequence, 1)
    save(out, threads, {"layers": layers(points, threads, rounds)})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "sparse_layer"))

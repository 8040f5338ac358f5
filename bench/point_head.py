"""Time of the point head beside the machine's peak, single layers beside other libraries, refinement, memory.

python -m bench.point_head --sequence ../shared/data/kitti/sequences/00 --labelled .../sequences/90 --out head.json
"""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import ROOT, interleaved, save, show, summary
from bench.scans import load_frames
from runtime.arena import Arena
from runtime.head_config import FULL, LITE, PointHeadConfig
from runtime.inputs import InputBuilder
from runtime.kernel_map import build_scales, neighbours, table_map
from runtime.point_head import FeatureMap, PointHeadEngine, fold
from runtime.sensor import HISTORY, Residual, Sensor
from runtime.sparse_conv import convolve, pack
from runtime.voxels import voxelise
from runtime.workers import Workers

HEADS = {"lite": LITE, "full": FULL}
PEAK = 2048  # rows and columns of the matrix product that is taken for the machine's peak


def reference_weights(name: str) -> dict[str, np.ndarray]:
    """The published layout with random weights (seed 2026)."""
    path = ROOT / "tests" / "data" / "published" / "reference_weights.py"
    spec = importlib.util.spec_from_file_location("reference_weights", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return dict(module.reference_state_dict(f"point_head_{name}", 2026))


def head(name: str, threads: int, **changes: Any) -> PointHeadEngine:
    config = replace(HEADS[name], **changes)
    return PointHeadEngine(fold(reference_weights(name), config), config, Workers(threads))


class Scan:
    """Arguments of `refine` for a scan, with random image features."""

    def __init__(self, points: np.ndarray) -> None:
        sensor, random = Sensor(), np.random.default_rng(0)
        image = InputBuilder(sensor, Residual(), Workers(1)).build(points, [None] * HISTORY, [None] * HISTORY)
        features = random.normal(size=(32, sensor.height, sensor.width)).astype(np.float32)
        self.xyz, self.valid = np.ascontiguousarray(points[:, :3]), image.pixel >= 0
        self.args = self.xyz, self.valid, FeatureMap(features, image.u, image.v)


def peak() -> Callable[[], object]:
    """A single-precision matrix product with as many threads as NumPy's BLAS takes."""
    a, b, c = (np.ones((PEAK, PEAK), np.float32) for _ in range(3))
    return lambda: np.matmul(a, b, out=c)


def whole_scan(scan: Scan, threads: int, rounds: int) -> dict[str, Any]:
    """Both heads on a whole scan, and the matrix product in the same run."""
    engines = {name: head(name, threads) for name in HEADS}
    tasks: dict[str, Callable[[], object]] = {
        name: lambda e=engine: e.refine(*scan.args) for name, engine in engines.items()
    }
    seconds = interleaved({**tasks, "sgemm": peak()}, rounds)
    sgemm = 2 * PEAK**3 / float(np.median(seconds["sgemm"])) / 1e9
    rows: dict[str, Any] = {}
    for name, engine in engines.items():
        taken, steps = float(np.median(seconds[name])), engine.timing
        rate = 2 * engine.multiply_adds / taken / 1e9
        rows[name] = {
            **summary(seconds[name]),
            "GFLOP/s": rate,
            "of sgemm %": 100 * rate / sgemm,
            "convolutions alone %": 100 * rate / sgemm * sum(steps.values()) / steps["convolutions"],
            "maps, voxels, transfers %": 100 * (1 - steps["convolutions"] / sum(steps.values())),
            "workspace MB": engine.workspace / 1e6,
        }
    rows["sgemm"] = {**summary(seconds["sgemm"]), "GFLOP/s": sgemm}
    show(f"whole scan, {len(scan.xyz)} points, {engine.voxels} voxels, ms", rows)
    return rows


def torch_layer(features: np.ndarray, kernel: np.ndarray, pairs: list[Any], threads: int) -> Callable[[], np.ndarray]:
    """Gather, matrix product, index_add: the convolution in plain PyTorch, pairs given."""
    import torch

    torch.set_num_threads(threads)
    x, w = torch.from_numpy(features), torch.from_numpy(kernel)
    rows = [(torch.from_numpy(i), torch.from_numpy(o)) for i, o in pairs]

    def run() -> np.ndarray:
        out = torch.zeros(len(x), w.shape[2])
        for k, (i, o) in enumerate(rows):
            out.index_add_(0, o, x[i] @ w[k])
        return out.numpy()

    return run


def spconv_layer(coords: np.ndarray, features: np.ndarray, kernel: np.ndarray) -> Callable[[], np.ndarray]:
    """The same layer (map and convolution) in spconv's CPU path; raises ImportError where it is not installed."""
    import spconv.pytorch as spconv
    import torch

    layer = spconv.SubMConv3d(kernel.shape[1], kernel.shape[2], 3, bias=False, algo=spconv.ConvAlgo.Native)
    weight = kernel.reshape(3, 3, 3, *kernel.shape[1:]).transpose(4, 0, 1, 2, 3)  # out z y x in
    layer.weight.data = torch.from_numpy(np.ascontiguousarray(weight)).reshape(layer.weight.shape)
    indices = torch.from_numpy(np.ascontiguousarray(np.pad(coords[:, ::-1], ((0, 0), (1, 0))).astype(np.int32)))
    shape = (coords.max(axis=0)[::-1] + 1).tolist()

    def run() -> np.ndarray:
        with torch.no_grad():
            found = layer(spconv.SparseConvTensor(torch.from_numpy(features), indices, shape, 1))
        return np.asarray(found.features)

    return run


def single_layers(scan: Scan, threads: int, rounds: int) -> dict[str, Any]:
    """One 3x3x3 layer with its map: 32 -> 32 at stride 1 and 96 -> 96 at stride 2; outputs are compared first."""
    workers, arena, found = Workers(threads), Arena(), {}
    voxels = voxelise(scan.xyz, 0.05, workers, scan.valid)
    for level, channels in ((0, 32), (1, 96)):
        random = np.random.default_rng(1)
        keys = build_scales(voxels.keys, 1, Arena())[level].keys.copy()
        coords = np.unique(voxels.coords >> level, axis=0)
        order = np.array([int(sum((c >> b & 1) << 3 * b for b in range(21))) for c in range(coords.max() + 1)])
        coords = coords[np.argsort(order[coords[:, 0]] << 2 | order[coords[:, 1]] << 1 | order[coords[:, 2]])]
        features = random.normal(size=(len(keys), channels)).astype(np.float32)
        kernel = random.normal(0, 0.05, (27, channels, channels)).astype(np.float32)
        weights, out = pack(kernel), np.empty_like(features)

        def ours(keys=keys, features=features, weights=weights, out=out) -> np.ndarray:  # type: ignore[no-untyped-def]
            scales = build_scales(keys, 0, arena)
            table = neighbours(scales, 0, arena, workers)[0]
            kernel_map = table_map(table, len(keys), arena, workers, "layer")
            return convolve(features, kernel_map, weights, out, workers, relu=False)

        table = neighbours(build_scales(keys, 0, Arena()), 0, Arena(), workers)[0][:-1]
        pairs = [(table[table[:, k] < len(keys), k].astype(np.int64), np.flatnonzero(table[:, k] < len(keys))) for k in range(27)]
        tasks: dict[str, Callable[[], Any]] = {"this": ours}
        makers = {
            "PyTorch, without its map": lambda: torch_layer(features, kernel, pairs, threads),  # noqa: B023
            "spconv": lambda: spconv_layer(coords, features, kernel),  # noqa: B023
        }
        for name, make in makers.items():
            try:
                tasks[name] = make()
            except ImportError:
                continue
            difference = np.abs(tasks[name]() - ours()).max()
            if difference > 1e-3:
                raise ArithmeticError(f"{name} differs by {difference}")
        rows = {name: summary(values) for name, values in interleaved(tasks, rounds).items()}
        show(f"one 3x3x3 layer with its map, {channels} -> {channels} at stride {1 << level}, {len(keys)} voxels, ms", rows)
        found[f"{channels} at stride {1 << level}"] = rows
    return found


def refinement(scan: Scan, candidates: np.ndarray, threads: int, rounds: int) -> dict[str, Any]:
    """Refining candidates against a full run: time, and what becomes of their labels."""
    engine, rows = head("lite", threads), {}
    full = engine.refine(*scan.args)
    halos: dict[str, tuple[Any, ...]] = {
        "whole scan": (),
        "default halo": (candidates,),
        "exact halo": (candidates, "exact"),
        "no candidates": (np.zeros_like(candidates),),
    }
    tasks = {name: (lambda a=args: engine.refine(*scan.args, *a)) for name, args in halos.items()}
    seconds = interleaved(tasks, rounds)
    whole = float(np.median(seconds["whole scan"]))
    for name, task in tasks.items():
        result = task()
        kept = candidates & np.isfinite(result[:, 0])
        rows[name] = {**summary(seconds[name]), "of whole %": 100 * float(np.median(seconds[name])) / whole, "voxels": engine.voxels}
        if kept.any():
            rows[name]["same label %"] = 100 * float((result[kept].argmax(1) == full[kept].argmax(1)).mean())
            rows[name]["max difference"] = f"{np.abs(result[kept] - full[kept]).max():.1e}"
    show(f"refinement (lite), {100 * candidates.mean():.2f} % of the points are candidates, ms", rows)
    return rows


def resident() -> float:
    """Resident memory of this process in MB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def memory(scans: list[Scan], threads: int, count: int) -> dict[str, Any]:
    """Resident memory after `count` scans against that after 50: a sequence forwards and backwards."""
    engine = head("lite", threads)
    there_and_back = scans + scans[-2:0:-1]
    early = 0.0
    for i in range(count):
        engine.refine(*there_and_back[i % len(there_and_back)].args)
        if i == min(49, count - 1):
            early = resident()
    row = {"after scan 50, MB": early, "at the end, MB": resident(), "scans": count}
    show("memory (lite)", {"resident": row})
    return row


def sizes(scans: list[Scan], threads: int, rounds: int, plot: Path | None) -> dict[str, Any]:
    """Cost against the number of voxels: scans merged side by side in one frame, and parts of one."""
    engine, rows = head("lite", threads), {}
    merged = np.concatenate([scan.xyz[scan.valid] + np.float32(0.013 * i) for i, scan in enumerate(scans)])
    merged = np.pad(merged, ((0, 0), (0, 1)))
    for wanted in (1_000, 10_000, 50_000, 100_000, 200_000, 300_000, 500_000):
        points = merged[: int(wanted * 1.35)]
        near = points[np.argsort(np.abs(points[:, :2]).max(axis=1))] if wanted < 50_000 else points
        scan = Scan(near[:wanted] if wanted < 50_000 else points)
        seconds = interleaved({"": lambda s=scan: engine.refine(*s.args)}, rounds)[""]
        taken = float(np.median(seconds))
        rows[str(engine.voxels)] = {
            **summary(seconds),
            "ns per 1000 multiply-adds": 1e12 * taken / engine.multiply_adds,
            "multiply-adds, G": engine.multiply_adds / 1e9,
        }
    show("cost against size (lite), by number of voxels, ms", rows)
    if plot is not None:
        draw(rows, plot)
    return rows


def draw(rows: dict[str, Any], path: Path) -> None:
    """Time against voxels, both logarithmic."""
    from matplotlib.figure import Figure

    figure = Figure((6, 4), layout="constrained")
    axes = figure.subplots()
    axes.loglog([int(v) for v in rows], [row["median"] for row in rows.values()], "o-")
    axes.set(xlabel="voxels of 5 cm", ylabel="ms per scan", title="lite point head")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    labelled: Annotated[Path | None, typer.Option(help="A sequence with labels, for the candidates")] = None,
    threads: int = 2,
    rounds: int = 7,
    scans: Annotated[int, typer.Option(help="Scans of the memory test")] = 1000,
    plot: Annotated[Path | None, typer.Option(help="PNG of cost against size")] = None,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """All tables of the point head."""
    several = [Scan(points) for points, _ in load_frames(sequence, 8)]
    results: dict[str, Any] = {"whole_scan": whole_scan(several[0], threads, rounds)}
    results["single_layers"] = single_layers(several[0], threads, rounds)
    frame, moving = several[0], several[0].valid & (np.abs(several[0].xyz - several[0].xyz[1000]).max(axis=1) < 2)
    if labelled is not None:
        frame, moving = busiest(labelled)
    results["refinement"] = refinement(frame, moving, threads, rounds)
    results["sizes"] = sizes(several, threads, max(3, rounds // 2), plot)
    if scans:
        results["memory"] = memory(several, threads, scans)
    save(out, threads, results)


def busiest(sequence: Path) -> tuple[Scan, np.ndarray]:
    """The scan of a sequence with the most moving points, at most 2 % of it, and which they are."""
    best, most = None, -1
    for path in sorted((sequence / "labels").glob("*.label")):
        moving = (np.fromfile(path, np.uint32) & 0xFFFF) >= 251
        if most < moving.sum() <= 0.02 * len(moving):
            best, most = (path, moving), int(moving.sum())
    if best is None:
        raise typer.BadParameter(f"no scan of {sequence} has labels with at most 2 % of moving points")
    path, moving = best
    points = np.fromfile(sequence / "velodyne" / f"{path.stem}.bin", np.float32).reshape(-1, 4)
    return Scan(points), moving & points[:, :3].any(axis=1)


if __name__ == "__main__":
    typer.run(bench)

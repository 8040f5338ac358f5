"""The paper's runtime table on this machine: `python -m bench.latency`.

Networks of the paper run with random weights, for their time does not follow content: the point head looks at every
point ("all"), or at given ones (2 % of the scan, the labelled movers). The default bundle runs as it is. Every row has
a process of its own, so that its peak of memory is its own.
"""

import multiprocessing
import resource
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import typer

from bench.plot import stacked_bars
from bench.report import interleaved, save, show, summary
from bench.scans import there_and_back
from runtime import MosRunner
from runtime.bundle.residual import HISTORY
from runtime.classes import MOVING, to_classes
from runtime.commands.handler import run_alone
from runtime.head.refiners import Head
from runtime.recordings.labels import write_labels
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording

SHOWN = ("read", "input", "network", "postprocess", "history", "write", "scan")


class Row(NamedTuple):
    """A system of the table."""

    config: str  # name of a configuration; "": the default bundle
    postprocess: Literal["none", "knn", "head"] | None
    refine: Literal["near", "all"] = "near"
    share: float | None = None  # of the points that the point head takes for candidates; None: those that may move
    precision: Literal["auto", "float32", "int8"] = "float32"


ROWS = {
    "LMNet, kNN": Row("lmnet", "knn"),
    "v1, kNN": Row("v1", "knn"),
    "LiMoSeg": Row("limoseg", "none"),
    "LiMoSeg in INT8": Row("limoseg", "none", precision="int8"),
    "Cylinder3D": Row("cylinder3d", "none"),
    "v2-lite, 2 % of points": Row("v2-lite", "head", "near", 0.02),
    "v2-lite in INT8, 2 % of points": Row("v2-lite", "head", "near", 0.02, "int8"),
    "v2-lite, all points": Row("v2-lite", "head", "all"),
    "v2, all points": Row("v2", "head", "all"),
    "default bundle": Row("", None, precision="auto"),
    "default bundle, kNN": Row("", "knn", precision="auto"),
}


def random_bundle(config: str, precision: str, folder: Path) -> Path:
    """The bundle of a configuration of the paper with random weights."""
    import torch

    from export.convert import export_checkpoint
    from export.int8.quantise import Settings
    from mos_model.networks import checkpoint
    from mos_model.networks.registry import named_config

    torch.manual_seed(0)
    model = named_config(config)
    path = folder / f"{config}.pt"
    checkpoint.save(path, model, model.build_image_network(), model.build_point_head())
    whole = Settings(streets=1, judging=1) if precision == "int8" else None
    exported = export_checkpoint(
        path, folder / config, weights="float32", trained=False, precision=precision, int8=whole
    )
    return exported.bundle.path


def measure(row: Row, bundle: Path | None, folder: Path, threads: int, scans: int) -> dict[str, Any]:
    """Seconds of every stage over `scans` scans of a sequence, back and forth, with a full history."""
    recording = open_recording(folder, Options(limit=60))
    runner = MosRunner(bundle, threads=threads, postprocess=row.postprocess, refine=row.refine, precision=row.precision)
    forced = None if row.share is None else Forced(runner, row.share)
    order = there_and_back(range(len(recording)))
    for i in range(HISTORY):
        scan = recording.read(order[i % len(order)])
        runner.remember(scan.data, scan.known_pose())
    stages: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as out:
        for i in range(HISTORY, HISTORY + scans + 1):
            scan, read = _timed(recording.read, order[i % len(order)])
            if forced is not None:
                forced.choose(scan.data)
            result, ran = _timed(runner, scan.data, scan.known_pose())
            _, wrote = _timed(write_labels, Path(out) / "scan.label", result.moving)
            if i > HISTORY:  # the first result lays out memory
                seconds = {**result.timing, "read": read, "write": wrote, "scan": read + ran + wrote}
                for stage, value in seconds.items():
                    stages.setdefault(stage, []).append(value)
    found = {stage: summary(stages[stage]) for stage in (*SHOWN, "total")}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    manifest = runner.bundle.manifest
    kind = {"network": manifest.name, "precision": runner.precision, "postprocess": runner.postprocess}
    return {"ms": found, "peak_mb": round(peak), **kind}


class Forced:
    """Lets the point head of a runner look at a share of the points, whatever the image network says."""

    def __init__(self, runner: MosRunner, share: float) -> None:
        assert isinstance(runner._stages.refiner, Head)
        head = runner._stages.refiner.head
        self.share, self.chosen = share, np.empty(0, bool)
        refine = head.refine
        head.refine = lambda xyz, valid, features, _, halo: refine(xyz, valid, features, self.chosen & valid, halo)

    def choose(self, points: np.ndarray, clusters: int = 5) -> None:
        """The points (N, 4) that are nearest to five of them."""
        self.chosen, each = np.zeros(len(points), bool), int(self.share * len(points) / clusters)
        for i in np.random.default_rng(0).choice(len(points), clusters, replace=False):
            distance = np.abs(points[:, :3] - points[i, :3]).max(axis=1)
            self.chosen[np.argpartition(distance, each)[:each]] = True


def measure_head(config: str, folder: Path, threads: int, rounds: int) -> dict[str, Any]:
    """The point head alone on one scan, random weights: all points and the labelled movers; PyTorch on all."""
    import torch

    from export.bundle.head_weights import fold
    from mos_model.networks.registry import named_config
    from runtime.compute.workers import Workers
    from runtime.head.numba_engine import FeatureMap, PointHeadEngine
    from runtime.image.inputs import InputBuilder

    torch.manual_seed(0)
    torch.set_num_threads(threads)
    model = named_config(config)
    head = model.build_point_head()
    assert head is not None
    assert model.point_head is not None
    head.eval()
    weights = fold({key: value.numpy() for key, value in head.state_dict().items()}, model.point_head)
    engine = PointHeadEngine(weights, model.point_head, Workers(threads))
    recording = open_recording(folder, Options(limit=60))
    index = len(recording) // 2
    points = recording.read(index).data
    builder = InputBuilder(model.range_image, model.residual, Workers(threads))
    entered = builder.enter(points)
    built = builder.build(entered, [])
    shape = (32, model.range_image.height, model.range_image.width)
    image = np.random.default_rng(0).normal(0, 1, shape).astype(np.float32)
    xyz, valid = np.ascontiguousarray(points[:, :3]), entered.takes_part
    features = FeatureMap(image, built.pixel, model.range_image.width)
    rows = torch.from_numpy(image.reshape(32, -1).T[built.pixel[valid]].copy())

    @torch.inference_mode()
    def plain() -> np.ndarray:
        return head(head.grid(torch.from_numpy(xyz[valid])), rows).softmax(1).numpy()

    ours = engine.refine(xyz, valid, features)[valid]
    tasks = {"all points": lambda: engine.refine(xyz, valid, features), "PyTorch, all points": plain}
    labels = recording.labels(index)
    share = None
    if labels is not None:
        moving = valid & (to_classes(labels) == MOVING)
        share = float(moving.mean())
        tasks["labelled movers"] = lambda: engine.refine(xyz, valid, features, moving)
    return {
        "ms": {name: summary(seconds) for name, seconds in interleaved(tasks, rounds).items()},
        "largest_difference": float(np.abs(ours - plain()).max()),
        "share_of_movers": share,
    }


def measure_network(config: str, threads: int, rounds: int, compiled: bool) -> dict[str, dict[str, Any]]:
    """The image network alone in PyTorch, ONNX Runtime and OpenVINO."""
    from bench.image_net import compare  # with torch, which the other processes are measured without

    return compare(config, 16 if config == "rt" else 32, threads, rounds, compiled)[0]


def _timed(call: Any, *arguments: Any) -> tuple[Any, float]:
    started = perf_counter()
    result = call(*arguments)
    return result, perf_counter() - started


def alone(call: Any, *arguments: Any) -> Any:
    """The result of a call in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(call, arguments)


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    threads: int = 2,
    scans: Annotated[int, typer.Option(help="Of the default bundle")] = 200,
    slow_scans: Annotated[int, typer.Option(help="Of the others")] = 7,
    rounds: Annotated[int, typer.Option(help="Of the engines side by side")] = 5,
    quick: Annotated[bool, typer.Option("--quick", help="Two minutes: fewer scans, no v2 nor Cylinder3D")] = False,
    compiled: Annotated[bool, typer.Option("--compiled", help="PyTorch's compiler too (takes minutes)")] = False,
    out: Annotated[Path | None, typer.Option(help="JSON file; a plot (SVG) beside it")] = None,
) -> None:
    """From scan and pose to labels, stage by stage; image networks and point heads beside PyTorch and OpenVINO."""
    if quick:
        scans, slow_scans, rounds = 50, 2, 2
    slow = ("v2", "lmnet", "cylinder3d")
    rows = {name: row for name, row in ROWS.items() if not (quick and (row.share or row.config in slow))}
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        if sequence is None:
            from mos_model.simulator.write import write_dataset

            sequence = write_dataset(work / "street", 1, 40, 7).path / "sequences" / "00"
        found: dict[str, dict[str, Any]] = {}
        for name, row in rows.items():
            bundle = alone(random_bundle, row.config, row.precision, work) if row.config else None
            count = slow_scans if row.config else scans
            found[name] = alone(measure, row, bundle, sequence, threads, count)
            typer.echo(f"{name}: {found[name]['ms']['scan']['median']:.0f} ms a scan", err=True)
        networks = {
            config: alone(measure_network, config, threads, rounds, compiled)
            for config in ("lmnet", "v1", "rt", "limoseg")
            if not (quick and config == "lmnet")
        }
        heads = {
            config: alone(measure_head, config, sequence, threads, rounds)
            for config in ("v2-lite", "v2")
            if not (quick and config == "v2")
        }
    table = {
        name: {stage: row["ms"][stage]["median"] for stage in SHOWN}
        | {"p95": row["ms"]["scan"].get("p95", ""), "scans": row["ms"]["scan"]["runs"], "peak MB": row["peak_mb"]}
        for name, row in found.items()
    }
    show(f"milliseconds a scan (median), {threads} threads; input: projection and residual images", table)
    show(
        f"image network alone, ms (median), {threads} threads",
        {name: {engine: row["median"] for engine, row in engines.items()} for name, engines in networks.items()},
    )
    show(
        f"point head alone, ms (median), {threads} threads",
        {name: {what: row["median"] for what, row in head["ms"].items()} for name, head in heads.items()},
    )
    save(out, threads, {"quick": quick, "rows": found, "image_networks_ms": networks, "point_heads": heads})
    if out is not None:
        bars = {name: {stage: row[stage] for stage in SHOWN[:-1]} for name, row in table.items()}
        stacked_bars(out.with_suffix(".svg"), bars, "ms a scan, median")


if __name__ == "__main__":
    sys.exit(run_alone(bench, "latency"))

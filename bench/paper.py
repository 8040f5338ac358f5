"""The paper's tables at a small width: `python -m bench.paper runs/paper --out bench/results/paper.json`.

Table I and the ablation: every method trains from each seed on the same simulated drives for the same number of steps,
and then a point head on its frozen image network. Thresholds come from calibration drives, scores from test drives
through `MosRunner`. The sensor is an HDL-64E with half of its lasers and a quarter of its firings, 32 x 512, which
leaves a point to a pixel as in the paper. The runtime table is what `bench.latency` and `bench.comparators` measured
last.

It may be stopped at any moment, and goes on with the same command: what lies in the folder of the runs is not done
again. The first seed of all methods comes before the second. After each method the tables are written anew.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import Annotated, Any

import numpy as np
import torch
import typer

from bench.accuracy import Drive, Scan, real, score, scores, with_runner
from bench.paper_tables import METHODS, Scores, claims, runtimes, shown, spread, summary
from bench.report import ROOT, save, show
from bench.sensors import thinned
from export.convert import export_checkpoint
from mos_model.data.dataset import SampleConfig
from mos_model.data.labelled import open_labelled
from mos_model.data.recorded import RecordedFrames
from mos_model.networks import checkpoint
from mos_model.networks.config import ModelConfig
from mos_model.networks.registry import named_config
from mos_model.simulator.write import write_dataset
from mos_model.training.distributed import join_ranks
from mos_model.training.recipe import TrainConfig, recipe
from mos_model.training.session import run_training
from mos_model.training.sources import Data
from mos_model.training.trainer import Limits
from mos_model.tuning.thresholds import histograms
from runtime import MosRunner
from runtime.bundle.head_shape import SMALL
from runtime.bundle.residual import HISTORY
from runtime.bundle.view import CylinderView
from runtime.commands.handler import run_alone
from runtime.errors import MosError
from runtime.files import write_whole
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import DEFAULT_SENSOR, SENSORS
from runtime.typed_json import read_json

LASERS, FIRINGS = 2, 4  # of which one is left
COLUMNS = 512
SENSOR = replace(
    SENSORS[DEFAULT_SENSOR],
    elevations=SENSORS[DEFAULT_SENSOR].elevations[::LASERS],
    azimuth_steps=COLUMNS,
    encoder_steps=0,
)
IMAGE = RangeImage(height=SENSOR.beams, width=COLUMNS)
SCORED = 2  # scans of a calibration or test drive, after a whole history


class Unfinished(Exception):
    """The time of this call is over."""


@dataclass(frozen=True)
class Settings:
    """What all methods share; a folder of runs is of one of these."""

    channels: int  # width of all networks at their finest stage (the paper's is 32)
    steps: int  # of stage 1
    head_steps: int  # of stage 2
    batch: int  # crops a step
    drives: int  # to train on
    frames: int  # scans of each
    tests: int  # test drives; half as many choose thresholds

    def keep(self, folder: Path) -> None:
        """Write these down in a new folder. Raises BadParameter where it holds runs of others."""
        kept = folder / "settings.json"
        mine = json.dumps(asdict(self))
        if kept.is_file() and kept.read_text() != mine:
            raise typer.BadParameter(f"{folder} holds runs of {kept.read_text()}, not {mine}: name another folder")
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(kept, mine.encode())

    def model(self, name: str) -> ModelConfig:
        """The network of a method, with a point head where the paper has one."""
        c = self.channels
        changes: dict[str, dict[str, Any]] = {
            "rt": {"widths": (c, 2 * c, 4 * c, 8 * c)},
            "limoseg": {"widths": (c, c, 2 * c, 4 * c)},
            "cylinder3d": {"cylinder": CylinderView(240, 128, 16)},  # as much coarser as the sensor
        }
        head = replace(SMALL, in_channels=c) if "head" in METHODS[name].kinds else None
        return named_config(METHODS[name].config, c, range_image=IMAGE, point_head=head, **changes.get(name, {}))

    def recipe(self, stage: int, seed: int, model: ModelConfig) -> TrainConfig:
        """As published, but for what a short training needs: AdamW, a cosine, crops (a quarter of the view)."""
        steps = self.steps if stage == 1 else self.head_steps
        return recipe(
            "paper", stage, seed=seed, steps=steps, batch=self.batch if stage == 1 else 2, mix=16, crops=4,
            crop=16 * round(model.view.shape[2] / 64), crop_on_moving=0.5, optimizer="adamw", learning_rate=0.006,
            weight_decay=0.01, schedule="cosine", warmup=steps // 20, clip=10.0, ema=0.98, weight_samples=64,
            validate_every=10**6, precision="fp32",
        )  # fmt: skip


@dataclass(frozen=True)
class Piece:
    """How much of the work is done in one call, and where."""

    folder: Path
    settings: Settings
    ends: float  # by `time.monotonic`
    threads: int

    def minutes(self) -> float:
        """What is left. Raises Unfinished where that is nothing."""
        if (left := (self.ends - monotonic()) / 60) <= 0:
            raise Unfinished
        return left

    def drives(self, use: str) -> Path:
        """The simulated drives for "train", "calibrate" or "test", made once for all."""
        counts = {"train": self.settings.drives, "calibrate": -(-self.settings.tests // 2), "test": self.settings.tests}
        root = self.folder / "drives" / use
        if not root.is_dir():
            self.minutes()
            frames = self.settings.frames if use == "train" else HISTORY + SCORED
            write_dataset(root, counts[use], frames, 1 + list(counts).index(use), SENSOR)
        return root

    @cached_property
    def data(self) -> Data:
        """To train on."""
        root = self.drives("train")
        return Data(root, tuple(sorted(path.name for path in (root / "sequences").iterdir())))

    def train(self, model: ModelConfig, config: TrainConfig, out: Path, init: Path | None = None) -> Path:
        """Train to the last step, from where an earlier call ended. Returns the checkpoint."""
        last = out / "last.pt"

        def done() -> bool:
            return last.is_file() and checkpoint.read(last).training["step"] >= config.steps

        if not done():
            run_training(
                model, lambda _: config, self.data, out, ranks=join_ranks("cpu"), workers=0, log_every=100,
                init=None if last.is_file() else init, resume=last.is_file(), limits=Limits(self.minutes(), 0.5),
            )  # fmt: skip
        if not done():
            raise Unfinished
        return last

    def bundle(self, name: str, seed: int) -> Path:
        """Both stages, thresholds, export. Returns the bundle."""
        model, folder = self.settings.model(name), self.folder / f"{name}-{seed}"
        if not (folder / "bundle" / "manifest.json").is_file():
            image, stages = replace(model, point_head=None), [self.settings.recipe(i, seed, model) for i in (1, 2)]
            trained = self.train(image, stages[0], folder / "stage1")
            if model.point_head is not None:
                trained = self.train(model, stages[1], folder / "stage2", init=trained)
            export_checkpoint(self.decided(trained, folder / "checkpoint.pt"), folder / "bundle", threads=self.threads)
        return folder / "bundle"

    def decided(self, trained: Path, out: Path) -> Path:
        """A checkpoint with the thresholds that are best on the calibration drives. Returns `out`."""
        found, root = checkpoint.load(trained), self.drives("calibrate")
        samples = SampleConfig.of(found.config, points=True)
        names = sorted(path.name for path in (root / "sequences").iterdir())
        labelled = open_labelled(root, names, found.config.range_image, trusted=True)
        frames = tuple((i, HISTORY + k) for i in range(len(labelled)) for k in range(SCORED))
        source = RecordedFrames(samples, tuple(labelled), frames, shuffle=False)
        self.minutes()
        whole = (sample for number in range(len(frames)) for sample in source.group(number))
        pixels, points = histograms(found, whole)
        of_head = None if found.point_head is None else points.best_threshold()[0]
        decision = {"threshold": pixels.best_threshold()[0], "head_threshold": of_head}
        training = {"decisions": {found.config.sensor: decision}, "trained": True, "data": "simulated drives"}
        checkpoint.save(out, found.config, found.image_net, found.point_head, training)
        return out

    def scores(self, name: str, seed: int, use: str, drives: list[Drive]) -> Scores:
        """IoU of a method by post-processing, kept beside its bundle."""
        kept = self.folder / f"{name}-{seed}" / f"{use}.json"
        if not kept.is_file():
            bundle = self.bundle(name, seed)
            self.minutes()
            systems = {
                kind: with_runner(MosRunner(bundle, threads=self.threads, postprocess=kind))
                for kind in METHODS[name].kinds
            }
            found = {kind: scores(confusion)["iou"] for kind, confusion in score(drives, systems).items()}
            write_whole(kept, json.dumps(found).encode())
        read: Scores = read_json(kept, MosError)
        return read


def fewer_firings(drive: Drive, step: int) -> Drive:
    """Points of every `step`-th column of the published range image."""

    def some() -> Iterator[Scan]:
        for scan in drive():
            turn = np.arctan2(scan.points[:, 1], scan.points[:, 0]) / (2 * np.pi) + 0.5
            kept = (turn * COLUMNS * FIRINGS).astype(np.int64) % step == 0
            yield scan._replace(points=scan.points[kept], classes=scan.classes[kept])

    return some


def bench(
    runs: Annotated[Path, typer.Argument(help="Folder of the runs: what is there already is not done again")],
    methods: Annotated[str, typer.Option(help="Rows, as a,b,limoseg")] = ",".join(METHODS),
    seeds: Annotated[int, typer.Option(min=1, help="Each method trains from so many")] = 3,
    channels: Annotated[int, typer.Option(help="Width of all networks (the paper's is 32)")] = 4,
    steps: Annotated[int, typer.Option(help="Of stage 1")] = 300,
    head_steps: Annotated[int, typer.Option(help="Of stage 2")] = 100,
    batch: Annotated[int, typer.Option(help="Crops a step")] = 4,
    drives: Annotated[int, typer.Option(help="Simulated drives to train on")] = 32,
    frames: Annotated[int, typer.Option(help="Scans of each")] = 24,
    tests: Annotated[int, typer.Option(help="Simulated test drives; half as many choose thresholds")] = 40,
    kitti: Annotated[Path | None, typer.Option(help="Root of KITTI sequence 90: scores on its scans too")] = None,
    minutes: Annotated[float, typer.Option(min=0, help="Stop after so long; the same command goes on")] = float("inf"),
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file, written after each method of each seed")] = None,
) -> None:
    """Table I, ablation and runtime: moving IoU (%) of each method by post-processing, with equal steps and data."""
    names = methods.split(",")
    if unknown := [name for name in names if name not in METHODS]:
        raise typer.BadParameter(f"there is no method {', '.join(unknown)}: choose of {', '.join(METHODS)}")
    settings = Settings(channels, steps, head_steps, batch, drives, frames, tests)
    settings.keep(runs)
    torch.set_num_threads(threads)
    piece = Piece(runs, settings, monotonic() + 60 * minutes, threads)
    uses = ["test"] if kitti is None else ["test", "real 90"]
    found: dict[str, dict[str, list[Scores]]] = {use: {name: [] for name in names} for use in uses}
    left = [f"{name} of seed {seed}" for seed in range(seeds) for name in names]

    def written() -> dict[str, Any]:
        results = {**asdict(settings), **tables(found), "remaining": left}
        save(out, threads, results)
        return results

    results = written()
    try:
        scored: dict[str, list[Drive]] = {"test": [real(path) for path in sorted(piece.drives("test").glob("*/*"))]}
        if kitti is not None:
            scored["real 90"] = [fewer_firings(thinned(real(kitti / "sequences/90"), LASERS), FIRINGS)]
        for seed in range(seeds):  # a seed of every method before the next: tables are whole early
            for name in names:
                of_all = {use: piece.scores(name, seed, use, scored[use]) for use in uses}
                for use in uses:
                    found[use][name].append(of_all[use])
                left.remove(f"{name} of seed {seed}")
                results = written()
    except Unfinished:
        pass
    title = f"{channels} channels, {steps} + {head_steps} steps"
    of_uses = {f"moving IoU, %, {use}: {title}": shown(results["summary"][use]) for use in uses}
    pairs = {f"{one['better']} > {one['worse']}": one for one in results["claims"]}
    for name, rows in (of_uses | {"points of IoU": pairs, "milliseconds a scan": results["runtimes"]}).items():
        if rows:
            show(name, rows)
    typer.echo(f"remaining: {', '.join(left) or 'nothing'}")


def tables(found: dict[str, dict[str, list[Scores]]]) -> dict[str, Any]:
    """All that the JSON file says of the scores, by the drives and by method."""
    measured = (read_json(ROOT / f"bench/results/{name}.json", MosError) for name in ("latency", "comparators"))
    pooled = {kind: spread(found["test"], kind) for kind in ("none", "knn", "head")}
    return {
        "percent": found,
        "summary": {use: summary(rows) for use, rows in found.items()},
        "spread": {kind: round(one.deviation, 2) for kind, one in pooled.items() if one.freedom},
        "claims": list(claims(found["test"])),
        "runtimes": runtimes(*measured),
    }


if __name__ == "__main__":
    sys.exit(run_alone(bench, "paper"))

"""The paper's ablation table at a small width: `python -m bench.ablation runs/ablation --out ablation.json`.

Every row (a to e) trains from the same seed on the same simulated streets for the same number of steps, and then a
point head on its frozen image network. Thresholds come from calibration streets, scores from other held-out streets
through `MosRunner`. What is finished in the folder of the runs is not done again.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import torch
import typer

from bench.accuracy import STREETS, score, scores, simulated, with_runner
from bench.report import save, show
from export.convert import export_checkpoint
from mos_model.networks import checkpoint
from mos_model.networks.config import ModelConfig
from mos_model.networks.registry import named_config
from mos_model.publish import publish
from mos_model.training.distributed import join_ranks
from mos_model.training.recipe import TrainConfig, recipe
from mos_model.training.session import run_training
from mos_model.training.sources import SIMULATED
from runtime import MosRunner
from runtime.bundle.head_shape import SMALL
from runtime.commands.handler import run_alone
from runtime.sensors.registry import DEFAULT_SENSOR
from runtime.settings import CHOICES

ROWS = {  # of the paper's table: what each adds
    "a": ("lmnet", "one branch (LMNet)"),
    "b": ("b", "two branches, attention"),
    "c": ("c", "b + SoftPool"),
    "d": ("d", "b + MetaKernel"),
    "e": ("e", "b + both"),
}


def train(model: ModelConfig, config: TrainConfig, out: Path, init: Path | None = None) -> Path:
    """Train to the last step, from where an earlier call was interrupted. Returns the checkpoint."""
    last = out / "last.pt"
    if last.is_file() and checkpoint.read(last).training["step"] >= config.steps:
        return last
    ranks = join_ranks("cpu")
    run_training(
        model, lambda _: config, SIMULATED, out, ranks=ranks, init=None if last.is_file() else init,
        resume=last.is_file(), workers=1, log_every=50,
    )  # fmt: skip
    return last


def make_bundle(model: ModelConfig, first: TrainConfig, second: TrainConfig, folder: Path) -> Path:
    """Both stages, thresholds, export. Returns the bundle."""
    bundle = folder / "bundle"
    if not (bundle / "manifest.json").is_file():
        image = train(replace(model, point_head=None), first, folder / "stage1")
        whole = train(model, second, folder / "stage2", init=image)
        publish(whole, folder / "checkpoint.pt", streets=12, data="simulated streets, for the ablation")
        export_checkpoint(folder / "checkpoint.pt", bundle)
    return bundle


def bench(
    runs: Annotated[Path, typer.Argument(help="Folder of the runs")],
    channels: Annotated[int, typer.Option(help="Width of all networks (the paper's is 32)")] = 8,
    steps: Annotated[int, typer.Option(help="Of stage 1")] = 600,
    head_steps: Annotated[int, typer.Option(help="Of stage 2")] = 250,
    crop: Annotated[int, typer.Option(help="Columns of the training crops")] = 256,
    seed: int = 0,
    streets: Annotated[int, typer.Option(help="Simulated test streets")] = 24,
    frames: Annotated[int, typer.Option(help="Scored scans of each")] = 2,
    rows: Annotated[str, typer.Option(help="Of the table")] = "abcde",
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Moving IoU (%) of rows a to e by post-processing, with equal steps, data and seeds."""
    torch.set_num_threads(threads)
    common: dict[str, Any] = {"seed": seed, "validate_every": 10**6, "validation_streets": 2, "weight_samples": 60}
    first = recipe("sim2real", steps=steps, crop=crop, crops=4, street_frames=6, warmup=steps // 10, ema=0.99, **common)
    second = recipe("sim2real", 2, steps=head_steps, street_frames=4, warmup=head_steps // 10, ema=0.99, **common)
    head = replace(SMALL, in_channels=channels)
    drives = simulated(DEFAULT_SENSOR, STREETS, streets, frames)
    table: dict[str, dict[str, float | None]] = {}
    found: dict[str, dict[str, dict[str, float | None]]] = {}
    for row in rows:
        name, what = ROWS[row]
        bundle = make_bundle(named_config(name, channels, point_head=head), first, second, runs / row)
        kinds = CHOICES["postprocess"]
        systems = {kind: with_runner(MosRunner(bundle, threads=threads, postprocess=kind)) for kind in kinds}
        found[row] = {kind: scores(confusion) for kind, confusion in score(drives, systems).items()}
        table[f"{row}: {what}"] = {kind: found[row][kind]["iou"] for kind in kinds}
        show(f"moving IoU, %: {channels} channels, {steps} + {head_steps} steps", table)
    settings = {"channels": channels, "steps": steps, "head_steps": head_steps, "crop": crop, "seed": seed}
    save(out, threads, settings | {"streets": streets, "frames": frames, "percent": found})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "ablation"))

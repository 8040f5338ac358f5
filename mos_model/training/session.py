"""A training run from its settings: data, weights to start from, and the loop."""

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from mos_model.data.dataset import class_frequency
from mos_model.data.recorded import RecordedFrames
from mos_model.networks import checkpoint
from mos_model.networks.config import ModelConfig
from mos_model.training.distributed import Ranks
from mos_model.training.losses import class_weights
from mos_model.training.progress import Display
from mos_model.training.recipe import PUBLISHED_EPOCH, TrainConfig
from mos_model.training.resuming import check_resumable, check_start
from mos_model.training.sources import Data, recorded_data, simulated_data
from mos_model.training.tasks import ImageTask, PointTask, Task
from mos_model.training.trainer import Limits, Trainer
from runtime.errors import SettingError


def run_training(
    model: ModelConfig,
    recipe: Callable[[int], TrainConfig],
    data: Data,
    out: Path,
    *,
    ranks: Ranks,
    init: Path | None = None,
    init_head: Path | None = None,
    resume: bool = False,
    workers: int = 1,
    limits: Limits | None = None,
    log_every: int = 20,
) -> float:
    """Train `model` and return the best validation IoU; `recipe` gives the settings for an epoch's steps.

    Writes last.pt, best.pt and metrics.jsonl into `out`. `init`: a checkpoint to start from; stage 2 needs
    one of stage 1. `init_head`: one whose point head stage 2 starts from. `resume`: go on from out/last.pt, of a
    run with the same settings.
    """
    previous = checkpoint.read(out / "last.pt") if resume else None
    start = checkpoint.read(init) if init else previous
    config = recipe(PUBLISHED_EPOCH)
    make_data = recorded_data if data.root else simulated_data
    source, validation = make_data(model, config, data)
    if isinstance(source, RecordedFrames):
        config = recipe(max(1, len(source.frames) * source.group_size // (config.batch * ranks.world)))
    out.mkdir(parents=True, exist_ok=True)
    with Display(out, log_every=log_every, quiet=ranks.rank > 0) as display:
        if previous:
            check_resumable(previous, model, config, ranks)
            weights = torch.tensor(previous.training["class_weights"])
        else:
            frequency = class_frequency(source, config.weight_samples)
            weights = torch.from_numpy(class_weights(frequency, config.class_weights))
        task = build_task(model, config, weights, start, init, ranks)
        if init_head and isinstance(task, PointTask):
            checkpoint.load_state(task.trained, checkpoint.read(init_head).point_head or {}, f"{init_head}: point head")
        notes = {"data": data.to_dict()}
        trainer = Trainer(task, config, source, validation, out, ranks=ranks, workers=workers, notes=notes)
        if previous:
            trainer.resume(previous.training)
        display.note(_describe(trainer, model, weights))
        return trainer.run(limits or Limits(), display)


def build_task(
    model: ModelConfig,
    config: TrainConfig,
    weights: Tensor,
    start: checkpoint.Stored | None,
    path: Path | None,
    ranks: Ranks,
) -> Task:
    """The modules of a stage, with new weights by the seed, or those of checkpoint `start` of `path`."""
    torch.manual_seed(config.seed)
    if config.stage == 1:
        task = ImageTask(model, weights, ranks.device)
        if path and start:
            check_start(start, model)
            checkpoint.load_state(task.trained, start.image_net, f"{path}: image network")
        return task
    if start is None:
        raise SettingError("stage 2 trains the point head of a trained image network: give its checkpoint (`init`)")
    check_start(start, model)
    return PointTask(model, start.image_network(), weights, ranks.device)


def _describe(trainer: Trainer, model: ModelConfig, weights: Tensor) -> str:
    parameters = sum(p.numel() for p in trainer.task.trained.parameters())
    precision = str(trainer.precision).removeprefix("torch.")
    return (
        f"{model.name}, {model.channels} channels, stage {trainer.config.stage}: {parameters / 1e6:.2f} M "
        f"parameters; {trainer.ranks.device}, {precision}, {torch.get_num_threads()} threads; "
        f"class weights {', '.join(f'{w:.3f}' for w in weights.tolist())}"
    )

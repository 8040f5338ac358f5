"""The training loop: steps, validation, checkpoints, exact resume, several processes.

A step is a function of the weights, the optimiser and its number alone: the batch, the learning rate and the
random numbers (dropout) of step n depend on the seed and n only. So resuming needs no other state, and gives
the same bits.
"""

import time
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from mos_model.data.dataset import Sample, Source
from mos_model.data.stream import Stream
from mos_model.training.distributed import Ranks
from mos_model.training.losses import Loss
from mos_model.training.progress import Display
from mos_model.training.recipe import TrainConfig
from mos_model.training.tasks import Task
from mos_model.training.validation import Validation, evaluate_task
from runtime.errors import TrainingError
from runtime.evaluation.confusion import Confusion


@dataclass(frozen=True)
class Limits:
    """When a run pauses and saves, whatever its recipe."""

    minutes: float = float("inf")  # of this run, then it stops
    save_minutes: float = 5.0  # between checkpoints


class Average:
    """Exponential moving average of a module's floating-point tensors; the others are copied."""

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self.state = _copied(module)

    @torch.no_grad()
    def update(self, module: nn.Module, step: int) -> None:
        """Move towards the module's tensors after step 1, 2, ...; faster at the start."""
        decay = min(self.decay, (1 + step) / (10 + step))
        now = module.state_dict()
        averaged = [key for key, value in now.items() if value.is_floating_point()]
        torch._foreach_lerp_([self.state[key] for key in averaged], [now[key] for key in averaged], 1 - decay)
        for key in now.keys() - set(averaged):
            self.state[key].copy_(now[key])


class Trainer:
    """Trains the modules of a `Task`. `step` steps are done."""

    def __init__(
        self,
        task: Task,
        config: TrainConfig,
        source: Source,
        validation: Validation | None,
        out: Path,
        *,
        ranks: Ranks,
        workers: int = 1,
        notes: dict[str, Any] | None = None,
    ) -> None:
        """notes: plain values that go into every checkpoint."""
        self.task, self.config, self.source, self.validation = task, config, source, validation
        self.out, self.ranks, self.workers, self.notes = out, ranks, workers, notes or {}
        self.step = 0
        self.best = float("-inf")  # validation IoU
        module = task.trained
        self.optimizer = make_optimizer(module, config)
        self.average = Average(module, config.ema) if config.ema else None
        self.precision = choose_precision(config.precision, ranks.device)
        self.scaler = torch.amp.GradScaler(ranks.device.type, enabled=self.precision == torch.float16)
        self.parallel = DistributedDataParallel(module) if ranks.world > 1 else module

    def run(self, limits: Limits, display: Display) -> float:
        """Train to the last step, or for the minutes given. Returns the best validation IoU (-inf: none)."""
        started = saved = time.monotonic()
        train, config = Confusion(), self.config
        with Stream(
            self.source,
            config.batch,
            seed=config.seed,
            mix=config.mix,
            workers=self.workers,
            rank=self.ranks.rank,
            world=self.ranks.world,
            position=self.step,
        ) as stream:
            batches = iter(stream)
            display.start(self.step, config.steps)
            while self.step < config.steps:
                rate = config.learning_rate_at(self.step)
                loss = self.take_step(next(batches), train)
                display.step(self.step, loss, rate, train, config.batch * self.ranks.world)
                now = time.monotonic()
                stop = self.ranks.agree(now - started > 60 * limits.minutes)
                if self.step % config.validate_every == 0 or self.step == config.steps:
                    self.validate(display)
                    train, saved = Confusion(), now
                    self.save("last.pt", whole=True)
                elif stop or now - saved > 60 * limits.save_minutes:
                    saved = now
                    self.save("last.pt", whole=True)
                if stop:
                    break
        return self.best

    def take_step(self, batch: list[Sample], train: Confusion) -> Loss:
        """One step of the optimiser; counts its predictions in `train`."""
        config = self.config
        torch.manual_seed((config.seed * 1_000_003 + self.step) * 1009 + self.ranks.rank)
        for group in self.optimizer.param_groups:
            group["lr"] = config.learning_rate_at(self.step)
        self.task.trained.train()
        if config.freeze_norm:
            freeze_norm(self.task.trained)
        with self.autocast():
            loss, labels, predicted = self.task.score(self.parallel, batch)
        if not torch.isfinite(loss.total):
            raise TrainingError(
                f"step {self.step}: the loss is {loss.total.item()} (cross-entropy "
                f"{loss.cross_entropy.item()}, Lovasz {loss.lovasz.item()}). Training stops; the last saved "
                f"step is in {self.out / 'last.pt'}. Lower the learning rate, clip the gradient or use fp32"
            )
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(self.scaler.scale(loss.total))
        if config.clip:
            self.scaler.unscale_(self.optimizer)
            nn.utils.clip_grad_norm_(self.task.trained.parameters(), config.clip)
        self.scaler.step(self.optimizer)
        self.scaler.update()
        self.step += 1
        if self.average:
            self.average.update(self.task.trained, self.step)
        train.add(labels.cpu(), predicted.cpu())
        return Loss(*(value.detach() for value in loss))

    def validate(self, display: Display) -> None:
        """Score the weights that would be saved; keep them as best.pt if they are the best so far."""
        if self.validation is None:
            return
        with self.averaged():
            confusion = evaluate_task(self.task, self.validation, self.ranks, self.autocast)
        display.validation(self.step, confusion)
        if confusion.iou > self.best:
            self.best = confusion.iou
            self.save("best.pt", whole=False)

    def averaged(self) -> Any:
        """Context in which the trained module holds the averaged weights."""
        return _Swapped(self.task.trained, self.average.state) if self.average else nullcontext()

    def autocast(self) -> Any:
        """Context of the precision."""
        if self.precision == torch.float32:
            return nullcontext()
        return torch.autocast(self.ranks.device.type, self.precision)

    def save(self, name: str, whole: bool) -> None:
        """Write a checkpoint of the (averaged) weights; `whole`: with all that resuming needs."""
        if self.ranks.rank:
            return
        training: dict[str, Any] = {
            "config": self.config.to_dict(),
            "step": self.step,
            "world": self.ranks.world,
            "best": self.best,
            "class_weights": self.task.weights.tolist(),
            **self.notes,
        }
        if whole:
            training["resume"] = {
                "module": _copied(self.task.trained),  # since the module holds other tensors below
                "optimizer": self.optimizer.state_dict(),
                "scaler": self.scaler.state_dict(),
                "average": self.average.state if self.average else None,
            }
        with self.averaged():
            self.task.save(self.out / name, training)

    def resume(self, training: dict[str, Any]) -> None:
        """Go on from the training state of a checkpoint that `save(whole=True)` wrote."""
        state = training["resume"]
        self.step, self.best = training["step"], training["best"]
        self.task.trained.load_state_dict(state["module"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.scaler.load_state_dict(state["scaler"])
        if self.average:
            for key, value in state["average"].items():
                self.average.state[key].copy_(value)


class _Swapped:
    """Context in which a module holds other tensors."""

    def __init__(self, module: nn.Module, state: dict[str, Tensor]) -> None:
        self.module, self.state = module, state

    def __enter__(self) -> None:
        self.own = _copied(self.module)
        self.module.load_state_dict(self.state)

    def __exit__(self, *_: object) -> None:
        self.module.load_state_dict(self.own)


def _copied(module: nn.Module) -> dict[str, Tensor]:
    return {key: value.detach().clone() for key, value in module.state_dict().items()}


def make_optimizer(module: nn.Module, config: TrainConfig) -> torch.optim.Optimizer:
    """The optimiser of a recipe. AdamW decays no biases and no BatchNorm."""
    rate, decay = config.learning_rate, config.weight_decay
    if config.optimizer == "sgd":
        return torch.optim.SGD(module.parameters(), rate, momentum=config.momentum, weight_decay=decay, fused=True)
    if config.optimizer == "adam":
        return torch.optim.Adam(module.parameters(), rate, weight_decay=decay, fused=True)
    parameters = list(module.parameters())
    groups: list[dict[str, Any]] = [
        {"params": [p for p in parameters if p.ndim > 1]},
        {"params": [p for p in parameters if p.ndim <= 1], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, rate, weight_decay=decay, fused=True)


def freeze_norm(module: nn.Module) -> None:
    """Let every BatchNorm normalise by its running statistics, as in use, and leave them as they are."""
    for layer in module.modules():
        if isinstance(layer, nn.modules.batchnorm._BatchNorm):
            layer.eval()


def choose_precision(name: str, device: torch.device) -> torch.dtype:
    """The type of the matrix products. "auto": bfloat16 where the device computes with it, else float32."""
    if name == "auto":
        if device.type == "cuda":
            fast = torch.cuda.is_bf16_supported(including_emulation=False)
        else:
            fast = bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
        return torch.bfloat16 if fast else torch.float32
    return {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}[name]

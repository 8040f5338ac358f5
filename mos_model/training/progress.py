"""What a training run shows (live in a terminal, else lines) and records (metrics.jsonl, TensorBoard)."""

import json
import math
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mos_model.training.losses import Loss
from runtime.evaluation.confusion import Confusion


class Display:
    """Shows and records a run. `quiet`: does neither (the processes but the first)."""

    def __init__(self, out: Path, *, log_every: int = 20, quiet: bool = False) -> None:
        self.console, self.log_every, self.quiet = Console(), log_every, quiet
        self._records = None if quiet else (out / "metrics.jsonl").open("a", encoding="utf-8")
        self._board: Any = None
        if not quiet:
            with suppress(ImportError):
                from torch.utils.tensorboard import SummaryWriter

                self._board = SummaryWriter(str(out / "tensorboard"))
        self._progress: Progress | None = None
        if self.console.is_terminal and not quiet:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
            )
            self._progress = Progress(*columns, console=self.console)
        self._since, self._samples, self._loss, self._steps = time.monotonic(), 0, 0.0, 0

    def start(self, step: int, steps: int) -> None:
        """The run begins (again) at `step` of `steps`."""
        self._begin, self._total, self._began = step, steps, time.monotonic()
        self._since = self._began
        if self._progress:
            self._progress.start()
            self._task = self._progress.add_task("training", total=steps, completed=step)

    def step(self, step: int, loss: Loss, rate: float, train: Confusion, samples: int) -> None:
        """`step` steps are done; the last had this loss, learning rate and number of samples."""
        if self.quiet:
            return
        self._samples += samples
        self._loss += loss.total.item()
        self._steps += 1
        if self._progress:
            self._progress.update(self._task, completed=step)
        if step == self._begin + 1:
            self._began = time.monotonic()  # what a step takes once all has started
        if self._steps < self.log_every and step != self._total:
            return
        now = time.monotonic()
        values = {
            "loss": self._loss / self._steps,
            "cross_entropy": loss.cross_entropy.item(),
            "lovasz": loss.lovasz.item(),
            "train_iou": train.iou,
            "learning_rate": rate,
            "samples_per_second": self._samples / max(1e-9, now - self._since),
        }
        left = (now - self._began) / max(1, step - self._begin - 1) * (self._total - step)
        self._show(
            step,
            f"step {step}/{self._total}  loss {values['loss']:.4f}  train IoU {100 * train.iou:.1f}  "
            f"lr {rate:.2e}  {values['samples_per_second']:.2f} samples/s  {_duration(left)} left",
        )
        self._record("train", step, values)
        self._since, self._samples, self._loss, self._steps = now, 0, 0.0, 0

    def validation(self, step: int, confusion: Confusion) -> None:
        """The score of the held-out samples after `step` steps."""
        if self.quiet:
            return
        values = {"iou": confusion.iou, "precision": confusion.precision, "recall": confusion.recall}
        text = "  ".join(f"{name} {100 * value:.1f}" for name, value in values.items())
        self.console.print(f"step {step}  validation: {text}", highlight=False, soft_wrap=True)
        self._record("validation", step, values)
        self._since = time.monotonic()

    def note(self, text: str) -> None:
        """One line for the reader."""
        if not self.quiet:
            self.console.print(text, highlight=False, soft_wrap=True)

    def _show(self, step: int, text: str) -> None:
        if self._progress:
            self._progress.update(self._task, description=text.split("  ", 1)[1], completed=step)
        else:
            self.console.print(text, highlight=False, soft_wrap=True)

    def _record(self, kind: str, step: int, values: dict[str, float]) -> None:
        if self._records:
            known = {name: value if math.isfinite(value) else None for name, value in values.items()}
            self._records.write(json.dumps({"kind": kind, "step": step, **known}) + "\n")
            self._records.flush()
        if self._board:
            for name, value in values.items():
                self._board.add_scalar(f"{kind}/{name}", value, step)

    def close(self) -> None:
        """Leave the terminal and the files in order."""
        if self._progress:
            self._progress.stop()
        if self._records:
            self._records.close()
        if self._board:
            self._board.close()

    def __enter__(self) -> "Display":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _duration(seconds: float) -> str:
    minutes = int(seconds // 60)
    return f"{minutes // 60}:{minutes % 60:02d} h" if minutes >= 60 else f"{minutes}:{int(seconds % 60):02d} min"

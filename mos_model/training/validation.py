"""Scoring on held-out samples while training."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field

import torch

from mos_model.data.dataset import Sample, Source
from mos_model.training.distributed import Ranks
from mos_model.training.tasks import Task
from runtime.evaluation.confusion import Confusion

AHEAD = 2  # groups that are made while others are scored


@dataclass
class Validation:
    """The first `groups` groups of a source; `keep`: in memory, once they were made."""

    source: Source
    groups: int
    keep: bool = False
    _kept: list[Sample] = field(default_factory=list)

    def samples(self, ranks: Ranks) -> Iterator[Sample]:
        """The share of this process."""
        if self._kept:
            yield from self._kept
            return
        with ThreadPoolExecutor(1) as reader:
            waiting: deque[Future[list[Sample]]] = deque()
            for number in range(ranks.rank, self.groups + AHEAD * ranks.world, ranks.world):
                if number < self.groups:
                    waiting.append(reader.submit(self.source.group, number))
                if waiting and (len(waiting) > AHEAD or number >= self.groups):
                    group = waiting.popleft().result()
                    if self.keep:
                        self._kept += group
                    yield from group


@torch.no_grad()
def evaluate_task(
    task: Task,
    validation: Validation,
    ranks: Ranks,
    autocast: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> Confusion:
    """Confusion of the predictions over the samples; every rank does its share and gets the sum."""
    task.trained.eval()
    confusion = Confusion()
    for sample in validation.samples(ranks):
        with autocast():
            _, labels, predicted = task.score(task.trained, [sample])
        confusion.add(labels.cpu(), predicted.cpu())
    confusion.matrix = ranks.sum(confusion.matrix)
    return confusion

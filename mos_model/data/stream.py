"""Batches of samples: shuffled, made ahead by worker processes, reproducible from any position."""

import math
import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from types import TracebackType

import numpy as np

from mos_model.data.dataset import Sample, Source
from runtime.errors import SettingError

_source: Source | None = None  # of a worker process


def _start_worker(source: Source) -> None:
    global _source
    _source = source
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A process that is killed tells its workers nothing: they would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _make_group(number: int) -> list[Sample]:
    assert _source is not None
    return _source.group(number)


class Stream:
    """Endless batches, lists of `batch` samples. Use as a context manager, or `close` it.

    The samples of `mix` groups are shuffled together (a *block*). Of `world` ranks, each takes every
    `world`-th block. The batch at a position is a function of the arguments only, whatever the number of
    workers, and reaching it costs at most the making of one block.
    """

    def __init__(
        self,
        source: Source,
        batch: int,
        *,
        seed: int = 0,
        mix: int = 8,
        workers: int = 1,
        rank: int = 0,
        world: int = 1,
        position: int = 0,
    ) -> None:
        """workers: processes (0: samples are made when they are needed); position: batches to leave out."""
        if batch < 1 or mix < 1 or workers < 0 or not 0 <= rank < world or position < 0:
            raise SettingError("a stream needs batch and mix of at least 1, workers and position of at least 0")
        step = batch // math.gcd(batch, source.group_size)
        self.source, self.batch, self.seed = source, batch, seed
        self.mix = -(-mix // step) * step  # a block is a whole number of batches
        self.rank, self.world, self.position = rank, world, position
        self._pool: ProcessPoolExecutor | None = None
        if workers:  # spawned, since a fork of a process with threads may hang
            self._pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start_worker, (source,))

    @property
    def batches_per_block(self) -> int:
        """Batches that are shuffled together."""
        return self.mix * self.source.group_size // self.batch

    def __iter__(self) -> Iterator[list[Sample]]:
        first = self.position // self.batches_per_block
        groups = self._groups(first)
        for turn, block in enumerate(self._blocks_from(first)):
            samples = [sample for _ in range(self.mix) for sample in next(groups)]
            batches = self._batches(samples, np.random.default_rng((self.seed, 1, block)))
            for batch in batches[self.position % self.batches_per_block if turn == 0 else 0 :]:
                self.position += 1
                yield [samples[i] for i in batch]

    def _batches(self, samples: list[Sample], rng: np.random.Generator) -> list[list[int]]:
        """Indices of the samples of a block, a list for each batch: shuffled, images of one shape together.

        Lists of points, which are images of one row, go together whatever their lengths.
        """
        shapes: dict[tuple[int, ...], list[int]] = {}
        for i in rng.permutation(len(samples)).tolist():
            shape = samples[i].labels.shape
            shapes.setdefault(shape[:1] if shape[0] == 1 else shape, []).append(i)
        batches = [each[k : k + self.batch] for each in shapes.values() for k in range(0, len(each), self.batch)]
        if len(batches) != self.batches_per_block:
            raise SettingError(
                f"samples of several shapes fill no batches of {self.batch}: give every street a number of samples "
                f"that is a multiple of it, not {self.source.group_size}"
            )
        return batches if len(shapes) == 1 else [batches[i] for i in rng.permutation(len(batches))]

    def _blocks_from(self, first: int) -> Iterator[int]:
        turn = first
        while True:
            yield turn * self.world + self.rank
            turn += 1

    def _groups(self, first: int) -> Iterator[list[Sample]]:
        """Groups in order; with workers, one block of them is under way ahead of the one that is taken."""
        numbers = (block * self.mix + i for block in self._blocks_from(first) for i in range(self.mix))
        if self._pool is None:
            yield from map(self.source.group, numbers)
            return
        waiting: deque[Future[list[Sample]]] = deque()
        while True:
            while len(waiting) < self.mix:
                waiting.append(self._pool.submit(_make_group, next(numbers)))
            yield waiting.popleft().result()

    def close(self) -> None:
        """End the worker processes."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def __enter__(self) -> "Stream":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

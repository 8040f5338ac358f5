"""Batches depend on the seed and the position, and on nothing else."""

import itertools
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mos_model.data.dataset import Sample
from mos_model.data.stream import Stream
from runtime.errors import SettingError
from tests.support.paths import ROOT
from tests.support.training import Patches


@dataclass(frozen=True)
class Numbers:
    """Samples that say which they are."""

    group_size: int = 3
    error_at: int = -1

    def group(self, number: int) -> list[Sample]:
        """See `Source`."""
        if number == self.error_at:
            raise ValueError("no such street")
        nothing = np.empty(0)
        return [
            Sample(np.array([number * self.group_size + i]), nothing, nothing, nothing, nothing)
            for i in range(self.group_size)
        ]


def take(count: int, source=None, batch=2, **options) -> list[list[int]]:
    """The sample numbers of the first `count` batches."""
    with Stream(source or Numbers(), batch, **({"mix": 4, "workers": 0} | options)) as stream:
        return [[int(s.image[0]) for s in samples] for samples in itertools.islice(stream, count)]


def flat(batches: list[list[int]]) -> list[int]:
    """All numbers in order."""
    return list(itertools.chain.from_iterable(batches))


def test_every_sample_once_and_mixed():
    batches = take(12)
    assert sorted(flat(batches)) == list(range(24))
    assert sorted(flat(batches[:6])) == list(range(12))  # a block is 4 groups of 3
    assert flat(batches) != list(range(24))


def test_seed():
    assert take(6) == take(6)
    assert take(6) != take(6, seed=1)


@pytest.mark.parametrize("position", [1, 5, 6, 8])
def test_any_position_is_reached_directly(position):
    assert take(12)[position:] == take(12 - position, position=position)


def test_position_counts_on():
    with Stream(Numbers(), 2, mix=4, workers=0, position=7) as stream:
        list(itertools.islice(stream, 3))
        assert stream.position == 10


def test_worker_processes_change_nothing():
    source = Patches(group_size=2)
    with Stream(source, 2, mix=2, workers=2) as ahead, Stream(source, 2, mix=2, workers=0) as plain:
        for one, other in itertools.islice(zip(ahead, plain, strict=False), 5):
            assert all(np.array_equal(a.image, b.image) for a, b in zip(one, other, strict=True))


def test_ranks_share_the_blocks():
    parts = [take(12, rank=rank, world=2) for rank in range(2)]
    assert sorted(flat(parts[0] + parts[1])) == list(range(48))
    assert flat(parts[0][:6]) == flat(take(6))  # rank 0 begins with the block that a lone process has


def test_a_block_is_whole_batches():
    with Stream(Numbers(3), 4, mix=1, workers=0) as stream:
        assert stream.mix == 4
        assert stream.batches_per_block == 3


def test_an_error_of_a_worker_arrives():
    with pytest.raises(ValueError, match="no such street"):
        take(12, source=Numbers(error_at=5), workers=1)


@pytest.mark.parametrize("options", [{"batch": 0}, {"mix": 0}, {"rank": 1}, {"workers": -1}, {"position": -1}])
def test_settings_out_of_range(options):
    with pytest.raises(SettingError):
        take(1, **options)


KILLED = """
import os, signal
from mos_model.data.stream import Stream
from tests.support.training import Patches

if __name__ == "__main__":
    stream = Stream(Patches(group_size=2), 2, mix=2, workers=1)
    next(iter(stream))
    print(*stream._pool._processes, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc, to see processes")
def test_workers_of_a_killed_process_end(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, env=environment)
    (worker,) = map(int, done.stdout.split())
    assert any(not is_running(worker) or time.sleep(0.1) for _ in range(600))


def is_running(process: int) -> bool:
    """Whether there is such a process, other than one that has ended and is not yet collected."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False

"""One recording after the other, in this process."""

from collections.abc import Sequence
from pathlib import Path

from runtime.fleet.work import Hear, Work, do


def label_here(work: Work, paths: Sequence[Path], hear: Hear) -> None:
    """Raises what `Work.runner` does."""
    with work.runner() as runner:
        for path in paths:
            hear(do(work, runner, path, hear))

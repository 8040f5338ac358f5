"""What stops and what starts: how many scans until it is seen, with and without belief: `python -m bench.changes`.

Objects of simulated streets whose label changes. One counts as called moving where at least half of its points are.
"""

import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from bench.report import save, show
from mos_model.simulator import simulate
from runtime import MosRunner
from runtime.bundle.residual import HISTORY
from runtime.classes import MOVING, to_classes
from runtime.commands.handler import run_alone
from runtime.sensors.registry import DEFAULT_SENSOR

STREETS = 12_500_000  # seeds
BEFORE, AFTER = 5, 12  # scans in which it did the one, and then the other
FEWEST = 20  # points of the object in a scan
SYSTEMS: dict[str, dict[str, object]] = {
    "every scan by itself": {"belief": "none"},
    "belief": {"belief": "online"},
    "belief, 10 scans later": {"delay": 10},
}


class Sight(NamedTuple):
    """An object in one scan."""

    moves: bool
    called: bool  # moving


Life = dict[int, Sight]  # by scan


def lives(drive: list[tuple[np.ndarray, np.ndarray]]) -> Iterator[Life]:
    """The objects of a drive: (labels, moving) of each of its scans."""
    seen: dict[int, Life] = defaultdict(dict)
    for index, (labels, moving) in enumerate(drive):
        moves = to_classes(labels) == MOVING
        for instance in np.unique(labels >> 16):
            its = labels >> 16 == instance
            if instance and np.count_nonzero(its) >= FEWEST:
                seen[int(instance)][index] = Sight(bool(moves[its].mean() > 0.5), bool(moving[its].mean() >= 0.5))
    yield from seen.values()


def waits(life: Life, starts: bool) -> Iterator[int]:
    """Scans from a change until it was seen, AFTER at most, for each time that the object started, or stopped."""
    for change in life:
        before = [life.get(change - 1 - i) for i in range(BEFORE)]
        after = [life.get(change + i) for i in range(AFTER)]
        whole = [sight for sight in (*before, *after) if sight is not None]
        if change - BEFORE < HISTORY or len(whole) < BEFORE + AFTER:
            continue
        if all(sight.moves != starts for sight in whole[:BEFORE]) and all(
            sight.moves == starts for sight in whole[BEFORE:]
        ):
            yield next((i for i, sight in enumerate(whole[BEFORE:]) if sight.called == starts), AFTER)


def row(found: list[int]) -> dict[str, float | None]:
    """Statistics of waits."""
    if not found:
        return {"objects": 0, "median": None, "9 of 10": None, "not seen": None}
    late = sum(wait == AFTER for wait in found)
    tenth = float(np.quantile(found, 0.9))
    return {"objects": len(found), "median": float(np.median(found)), "9 of 10": tenth, "not seen": late}


def bench(
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    streets: Annotated[int, typer.Option(help="Simulated streets")] = 60,
    frames: Annotated[int, typer.Option(help="Scans of each")] = 40,
    version: Annotated[int, typer.Option(help="Of the simulation")] = 2,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Scans until an object that starts is called moving, and until one that stops is not any more."""
    rows = {}
    runners = {name: MosRunner(bundle, threads=threads, **settings) for name, settings in SYSTEMS.items()}
    found: dict[tuple[str, bool], list[int]] = defaultdict(list)
    for seed in range(STREETS, STREETS + streets):
        scans = list(simulate(seed, frames, DEFAULT_SENSOR, version=version, rate=10.0, mount_height=1.73, pitch=0.0))
        for name, runner in runners.items():
            runner.reset()
            results = [result for scan in scans if (result := runner(scan.points, scan.pose)) is not None]
            moving = [result.moving for result in [*results, *runner.flush()]]
            for life in lives([(scan.labels, one) for scan, one in zip(scans, moving, strict=True)]):
                for starts in (True, False):
                    found[name, starts] += waits(life, starts)
    for name in runners:
        for starts, what in ((True, "starts"), (False, "stops")):
            rows[f"{what}: {name}"] = row(found[name, starts])
    show(f"scans until a change is seen, {AFTER} at most", rows)
    save(out, threads, {"streets": streets, "frames": frames, "version": version, "scans": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "changes"))

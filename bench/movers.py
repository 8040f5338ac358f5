"""Which movers are found, by kind and by distance: `python -m bench.movers [--sequence SEQUENCE --first 8]`.

The share of the moving points that are found, of each kind, of simulated test streets or of a labelled recording; and
the IoU of the moving class by distance. On simulated streets also by what the movers do: start, cross, go the sensor's
way or come towards it.
"""

import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from bench.accuracy import STREETS, percent
from bench.manners import MANNERS, manners
from bench.report import save, show
from mos_model.simulator import simulate
from runtime import MosRunner
from runtime.bundle.residual import HISTORY
from runtime.classes import KINDS, MOVING, STATIC, to_classes
from runtime.commands.handler import run_alone
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording

EDGES = (0, 10, 20, 30, 50, 80, 1000)  # m, of the distances


class Scan(NamedTuple):
    """A scan with its labels."""

    points: np.ndarray  # (N, 4) f32
    pose: np.ndarray  # (4, 4)
    labels: np.ndarray  # (N,) of SemanticKITTI
    scored: bool
    manners: Mapping[int, str] = {}  # of the instances that move, where they are known


def streets(sensor: str, count: int, frames: int, version: int) -> Iterator[list[Scan]]:
    """Simulated test streets."""
    for seed in range(STREETS, STREETS + count):
        drive = simulate(seed, HISTORY + frames, sensor, version=version)
        yield [Scan(one.points, one.pose, one.labels, k >= HISTORY, manners(drive, k)) for k, one in enumerate(drive)]


def recorded(path: Path, first: int) -> Iterator[list[Scan]]:
    """A labelled recording, scored from scan `first` on."""
    recording = open_recording(path, Options())
    scans = []
    for index, scan in enumerate(recording.scans()):
        labels = recording.labels(index)
        if labels is None:
            raise typer.BadParameter(f"{path}: scan {index} has no labels")
        scans.append(Scan(scan.data, scan.known_pose(), labels, index >= first))
    yield scans


class Counts:
    """Points by kind, manner and distance: moving ones, found or missed, and others that were called moving."""

    def __init__(self) -> None:
        self.found: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(len(EDGES) - 1, np.int64))
        self.there: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(len(EDGES) - 1, np.int64))
        self.false = np.zeros(len(EDGES) - 1, np.int64)

    def add(self, scan: Scan, moving: np.ndarray) -> None:
        """Count a scan."""
        distance = np.linalg.norm(scan.points[:, :3], axis=1)
        classes, kind, instance = to_classes(scan.labels), scan.labels & 0xFFFF, scan.labels >> 16
        groups = {name: kind == label for name, (_, label) in KINDS.items()}
        for name in MANNERS:
            groups[name] = np.isin(instance, [one for one, its in scan.manners.items() if its == name])
        groups["all"] = np.ones(len(kind), bool)
        for name, group in groups.items():
            its = (classes == MOVING) & group
            self.there[name] += np.histogram(distance[its], EDGES)[0]
            self.found[name] += np.histogram(distance[its & moving], EDGES)[0]
        self.false += np.histogram(distance[(classes == STATIC) & moving], EDGES)[0]

    def rows(self) -> dict[str, dict[str, float | None]]:
        """Recall of each kind, and IoU of all, in %, by distance."""
        names = [f"{a} to {b} m" if b < 1000 else f"from {a} m" for a, b in pairwise(EDGES)]

        def row(share: np.ndarray, total: float) -> dict[str, float | None]:
            values = [percent(float(one), 1) for one in share]
            return {"anywhere": percent(total, 1), **dict(zip(names, values, strict=True))}

        rows = {}
        with np.errstate(invalid="ignore"):
            for name, there in self.there.items():
                if there.any():
                    rows[f"{name}, found"] = row(self.found[name] / there, self.found[name].sum() / there.sum())
            union = self.there["all"] + self.false
            rows["IoU"] = row(self.found["all"] / union, self.found["all"].sum() / max(1, union.sum()))
        return rows


def bench(
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    sequence: Annotated[Path | None, typer.Option(help="Labelled recording", show_default="simulated streets")] = None,
    first: Annotated[int, typer.Option(help="Its first scan that counts")] = HISTORY,
    sensor: Annotated[str | None, typer.Option(help="Of the streets or the recording")] = None,
    count: Annotated[int, typer.Option("--streets", help="Simulated test streets")] = 60,
    frames: Annotated[int, typer.Option(help="Scored scans of each")] = 2,
    version: Annotated[int, typer.Option(help="Of the simulated streets")] = 1,
    belief: Annotated[str, typer.Option(help="auto, none or online")] = "auto",
    delay: Annotated[int, typer.Option(help="Scans that come later and count too")] = 0,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Recall of moving points by kind, manner and distance, and IoU by distance (%)."""
    counts = Counts()
    runner = MosRunner(bundle, threads=threads, sensor=sensor, belief=belief, delay=delay)
    name = sensor or runner.bundle.manifest.sensor.name
    for drive in recorded(sequence, first) if sequence else streets(name, count, frames, version):
        runner.reset()
        results = [result for one in drive if (result := runner(one.points, one.pose)) is not None]
        for scan, result in zip(drive, [*results, *runner.flush()], strict=True):
            if scan.scored:
                counts.add(scan, result.moving)
    rows = counts.rows()
    show("moving points found, and IoU, %", rows)
    simulated = {"seeds": [STREETS, STREETS + count - 1], "streets": count, "frames": frames, "version": version}
    seen = {"recording": sequence.name} if sequence else simulated
    save(out, threads, {"sensor": name, **seen, "belief": belief, "delay": delay, "percent": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "movers"))

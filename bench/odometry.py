"""What poses that are found cost, beside those that are given: `python -m bench.odometry --sequence SEQUENCE`."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import save, show, summary
from runtime import MosRunner
from runtime.classes import MOVING, STATIC, to_classes
from runtime.commands.handler import run_alone
from runtime.evaluation.confusion import Confusion
from runtime.odometry.kiss import KissOdometry
from runtime.odometry.located import Located, find_poses
from runtime.recordings.recording import Indexed
from runtime.recordings.registry import open_recording


class Timed:
    """An odometry, and the seconds of each scan."""

    def __init__(self, odometry: KissOdometry) -> None:
        self.odometry, self.name, self.seconds = odometry, odometry.name, list[float]()

    def locate(self, *scan: Any) -> np.ndarray:
        started = time.perf_counter()
        pose = self.odometry.locate(*scan)
        self.seconds.append(time.perf_counter() - started)
        return pose


def labelled(runner: MosRunner, recording: Indexed) -> Iterator[np.ndarray]:
    """(N,) what moves in each scan."""
    runner.reset()
    return (runner(scan).moving for scan in recording)


def bench(
    sequences: Annotated[list[Path], typer.Option("--sequence", help="With poses and labels; may be repeated")],
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Moving IoU, precision and recall (%) with given poses and with those of KISS-ICP; ms a scan that it takes."""
    runner = MosRunner(bundle, threads=threads)
    scores, costs = {}, {}
    for sequence in sequences:
        given = open_recording(sequence)
        timed = Timed(KissOdometry())
        found = find_poses(given, timed)
        for poses, recording in (("given", given), ("found", Located(given, found))):
            confusion = Confusion()
            for index, moving in enumerate(labelled(runner, recording)):
                confusion.add(to_classes(given.labels(index)), np.where(moving, MOVING, STATIC))
            scores[f"{given.name}, poses {poses}"] = {
                "IoU": 100 * confusion.iou,
                "precision": 100 * confusion.precision,
                "recall": 100 * confusion.recall,
            }
        costs[given.name] = {**summary(timed.seconds), "lost": len(found.lost)}
    show("moving class, %", scores)
    show("KISS-ICP, ms a scan", costs)
    names = {"odometry": KissOdometry().name, "bundle": runner.bundle.manifest.name}
    save(out, threads, {**names, "percent": scores, "ms": costs})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "odometry"))

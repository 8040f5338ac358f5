"""After how many scans is a drive that is wrong noticed, and is one that is right? `python -m bench.watching`.

The runner's own input path and its `Watch`, without the network: what a `MosRunner` warns of, and what that costs.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.corruption import HARMLESS, WRONG, Frames
from bench.report import save, show
from bench.scans import load_frames
from mos_model.simulator import simulate
from runtime.bundle.residual import Residual
from runtime.commands.handler import run_alone
from runtime.compute.workers import Workers
from runtime.doctor.watch import Watch
from runtime.errors import PoseError
from runtime.image.history import History
from runtime.image.inputs import InputBuilder
from runtime.recordings.poses import check_pose
from runtime.sensors.registry import SENSORS

SENSOR = SENSORS["hdl64e"]
OTHERS = ("os1-128", "os1-64", "hdl32e", "vlp16")  # seen by a network for the first


class Watcher:
    """The runner's path from scans to warnings."""

    def __init__(self) -> None:
        self.inputs = InputBuilder(SENSOR.range_image, Residual(lags=(1,)), Workers(1), SENSOR.reach)
        self.watch = Watch(SENSOR.range_image)
        self.seconds: list[float] = []  # of each look, CPU time

    def warnings(self, frames: Frames) -> list[str]:
        """ "12 ground" and the like: scans from 0 at which something is said, and its topic."""
        history, said = History(), []
        self.watch.reset()
        for number, (points, given) in enumerate(frames):
            try:
                pose = check_pose(given)
            except PoseError:
                return [*said, f"{number} PoseError"]
            scan = self.inputs.enter(points)
            if history.jump(pose, None):
                said.append(f"{number} jump")
                history.clear()
            past = history.past(pose)
            image = self.inputs.build(scan, past)
            started = time.thread_time()
            look = self.watch.look(points, image, past)
            self.seconds.append(time.thread_time() - started)
            self.watch.keep(look)
            said += [f"{number} {text.split(':')[0]}" for text in look.warnings]
            history.add(scan, pose, None)
        return said


def streets(count: int, scans: int, sensor: str = SENSOR.name, first: int = 0, **settings: Any) -> Sequence[Frames]:
    return [
        [(frame.points, frame.pose) for frame in simulate(first + seed, scans, sensor, **settings)]
        for seed in range(count)
    ]


def bench(
    kitti: Annotated[Path | None, typer.Option(help="Root with KITTI sequences 90 and 00")] = None,
    pandaset: Annotated[Path | None, typer.Option(help="Root with PandaSet's sequence 002")] = None,
    count: Annotated[int, typer.Option(help="Simulated streets; a tenth of it for each other sensor")] = 100,
    scans: Annotated[int, typer.Option(help="Of each street")] = 30,
    seed: Annotated[int, typer.Option(help="Of the first street")] = 5000,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Warnings about drives as they are, which should have none, and about drives that are wrong."""
    watcher = Watcher()
    real = {"90": kitti and kitti / "sequences/90", "00": kitti and kitti / "sequences/00"}
    real["PandaSet 002"] = pandaset and pandaset / "sequences/002"
    false: dict[str, list[str]] = {}
    drives = 0
    for name, folder in real.items():
        if folder is not None:
            false[name] = watcher.warnings(load_frames(folder, 10_000))
            drives += 1
    for sensor in (SENSOR.name, *OTHERS):
        for number in range(count if sensor == SENSOR.name else count // 10):
            (frames,) = streets(1, scans, sensor, seed + number)
            false[f"{sensor} {seed + number}"] = watcher.warnings(frames)
            drives += 1
    cost = 1e3 * float(np.mean(watcher.seconds))
    false = {name: said for name, said in false.items() if said}
    show("drives as they are", {"": {"drives": drives, "with a warning": len(false), "ms CPU a scan": cost}})
    drive = load_frames(kitti and kitti / "sequences/90", 24)
    first = {name: watcher.warnings(change(drive))[:1] for name, change in (HARMLESS | WRONG).items()}
    show("first warning", {name: {"scan, from 0, and topic": "; ".join(said)} for name, said in first.items()})
    results = {"drives": drives, "false": false, "ms_cpu_per_scan": round(cost, 3), "first": first}
    save(out, 1, results)


if __name__ == "__main__":
    sys.exit(run_alone(bench, "watching"))

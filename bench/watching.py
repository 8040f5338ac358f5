"""After how many scans is a drive that is wrong noticed, and is one that is right? `python -m bench.watching`.

The runner's own input path and its `Watch`, without the network: what a `MosRunner` warns of, and what that costs.
"""

import math
import sys
import time
from collections.abc import Sequence
from functools import partial
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
from runtime.doctor.alignment import LAGS, Fit, scans
from runtime.doctor.check_ground import TILTED
from runtime.doctor.sample import Sample
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
        self.fits: list[Fit] = []  # all that were made
        self.samples: list[Sample] = []

    def warnings(self, frames: Frames) -> list[str]:
        """ "12 ground" and the like: scans from 0 at which something is said, and its topic."""
        history, said = History(), []
        fits: tuple[Fit, ...] = ()
        samples: tuple[Sample, ...] = ()
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
            self.inputs.build(scan, past)
            started = time.thread_time()
            look = self.watch.look(points, partial(self.inputs.range_image, scan), past)
            self.seconds.append(time.thread_time() - started)
            self.watch.keep(look)
            self.fits += look.memory.fits[-1:] if look.memory.fits is not fits else ()
            self.samples += look.memory.samples[-1:] if look.memory.samples is not samples else ()
            fits, samples = look.memory.fits, look.memory.samples
            said += [f"{number} {text.split(':')[0]}" for text in look.warnings]
            history.add(scan, pose, None)
        return said


def usual(watcher: Watcher) -> dict[str, dict[str, float]]:
    """What the checks go by, over all that was looked at: quantiles, and the share that is beyond a limit."""
    rows = {}
    for lag in LAGS:
        fits = [fit for fit in watcher.fits if fit.lag == lag and not math.isnan(fit.given)]
        rows[f"misfit {scans(lag)} later, m"] = quantiles([fit.given for fit in fits])
        rows[f"misfit {scans(lag)} later, m"]["beyond, %"] = share([fit.wrong for fit in fits])
    seen = [sample for sample in watcher.samples if sample.tells]
    rows["median range, m"] = quantiles([sample.middle for sample in seen])
    grounds = [sample.ground for sample in seen if sample.ground and sample.ground.tilt < 60]
    rows["height over the ground, m"] = quantiles([ground.height for ground in grounds])
    rows["tilt, degrees"] = quantiles([ground.tilt for ground in grounds])
    rows["tilt, degrees"]["beyond, %"] = share([ground.tilt > TILTED for ground in grounds])
    return rows


def quantiles(values: list[float]) -> dict[str, float]:
    return {f"{part} %": round(float(np.percentile(values, part)), 3) for part in (1, 50, 90, 99)}


def share(wrong: list[bool]) -> float:
    return round(100 * float(np.mean(wrong)), 2)


def streets(count: int, length: int, sensor: str = SENSOR.name, first: int = 0, **settings: Any) -> Sequence[Frames]:
    return [
        [(frame.points, frame.pose) for frame in simulate(first + seed, length, sensor, **settings)]
        for seed in range(count)
    ]


def bench(
    kitti: Annotated[Path | None, typer.Option(help="Root with KITTI sequences 90 and 00")] = None,
    pandaset: Annotated[Path | None, typer.Option(help="Root with PandaSet's sequence 002")] = None,
    count: Annotated[int, typer.Option(help="Simulated streets; a tenth of it for each other sensor")] = 100,
    length: Annotated[int, typer.Option(help="Scans of each street")] = 30,
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
            (frames,) = streets(1, length, sensor, seed + number)
            false[f"{sensor} {seed + number}"] = watcher.warnings(frames)
            drives += 1
    cost = 1e3 * float(np.mean(watcher.seconds))
    false = {name: said for name, said in false.items() if said}
    right = usual(watcher)
    show("looks at drives as they are", right)
    show("drives as they are", {"": {"drives": drives, "with a warning": len(false), "ms CPU a scan": cost}})
    drive = load_frames(kitti and kitti / "sequences/90", 24)
    first = {name: watcher.warnings(change(drive))[:1] for name, change in (HARMLESS | WRONG).items()}
    show("first warning", {name: {"scan, from 0, and topic": "; ".join(said)} for name, said in first.items()})
    results = {"drives": drives, "false": false, "ms_cpu_per_scan": round(cost, 3), "right": right, "first": first}
    save(out, 1, results)


if __name__ == "__main__":
    sys.exit(run_alone(bench, "watching"))

"""From the checkpoint of a run to the one that ships: `python -m mos_model.publish RUN/last.pt OUT/checkpoint.pt`.

Keeps the tensors in half precision and chooses thresholds for every sensor of the network, and those of belief.
"""

import multiprocessing
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

from mos_model.networks.checkpoint import load, save
from mos_model.tuning.average import write_mean
from mos_model.tuning.belief import DELAY, Believed, find_belief
from mos_model.tuning.histogram import Histogram
from mos_model.tuning.thresholds import find_thresholds, has_few_beams, sensor_classes
from runtime.bundle.manifest import BeliefNumbers, Tuned
from runtime.commands.handler import run_alone
from runtime.commands.output import show_line
from runtime.errors import CheckpointError
from runtime.settings import CHOICES
from runtime.typed_json import build

# Of IoU, which counts points: online, of thresholds as good, the lowest misses fewest people, who have few of them
SLACK = 0.005


def data_of(training: Mapping[str, Any]) -> str:
    """What a run was trained on, in words."""
    data = training.get("data", {})
    if isinstance(data, str):  # of a checkpoint that was published before
        return data
    root = data.get("root")
    return f"recorded scans in {Path(root).name}" if root else "simulated streets of mos_model.simulator"


def in_two(classes: Sequence[tuple[str, ...]], found: Sequence[Believed]) -> Iterator[tuple[list[str], Believed]]:
    """Sensors whose thresholds are found together: those of few beams, whose points are few among the others', and the
    rest, which differ by less than drives do."""
    for few in (True, False):
        names: list[str] = []
        online, delayed = Histogram(), Histogram()
        for sensors, one in zip(classes, found, strict=True):
            if has_few_beams(sensors) == few:
                names += sensors
                online += one.online
                delayed += one.delayed
        if names:
            yield names, Believed(online, delayed)


def publish(
    checkpoint: Annotated[Path, typer.Argument(help="Checkpoint of a run")],
    out: Annotated[Path, typer.Argument(help="Checkpoint that ships")],
    streets: Annotated[int, typer.Option(min=1, help="Simulated streets for the thresholds; 5 x without movers")] = 40,
    drives: Annotated[
        int,
        typer.Option(min=0, help="Simulated drives of each kind of sensor for belief, half without movers; 0: none"),
    ] = 0,
    mean_with: Annotated[
        Path | None, typer.Option(help="Checkpoint that the run started from: the mean of both weights ships")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes")] = 2,
    name: Annotated[str | None, typer.Option(help="Of the bundle", show_default="the network's")] = None,
    postprocess: Annotated[str | None, typer.Option(help="none, knn or head: the bundle's default")] = None,
    data: Annotated[
        str | None, typer.Option(help="What the weights were trained on", show_default="what the run says")
    ] = None,
    licence: Annotated[str, typer.Option(help="Of the weights, for the manifest")] = "unknown",
) -> None:
    """Write the checkpoint that ships."""
    if postprocess not in (None, *CHOICES["postprocess"]):
        raise typer.BadParameter(f"{postprocess!r} is none of {', '.join(CHOICES['postprocess'])}")
    if mean_with is not None:
        scratch = TemporaryDirectory()  # goes with this call, however it ends
        mean = Path(scratch.name) / "mean.pt"
        write_mean(checkpoint, mean_with, mean)
        checkpoint = mean
    found = load(checkpoint)
    tuned = build(Tuned, found.training.get("tuned", {}), f"{checkpoint}: tuned", CheckpointError)
    if drives and tuned.belief is None:
        tuned = replace(tuned, belief=BeliefNumbers())
    decisions: dict[str, dict[str, float | None]] = {}
    classes = sensor_classes(found.config.sensor, found.config.other_sensors)
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        asked = [pool.submit(find_thresholds, checkpoint, sensors, streets, tuned.candidate) for sensors in classes]
        believed = [pool.submit(find_belief, checkpoint, tuned, sensors, drives) for sensors in classes if drives]
    for one in (each.result() for each in asked):
        decisions |= {each: one.decision for each in one.sensors}
        head = "" if one.head_iou is None else f"; point head {one.head_threshold:.3f}, {100 * one.head_iou:.1f}"
        show_line(f"{', '.join(one.sensors)}: threshold {one.threshold:.3f}, moving IoU {100 * one.iou:.1f}{head}")
    if drives:
        for names, of_them in in_two(classes, [each.result() for each in believed]):
            threshold, iou = of_them.online.best_threshold(SLACK)
            later, later_iou = of_them.delayed.best_threshold()
            for each in names:
                decisions[each] |= {"belief_threshold": threshold, "delayed_threshold": later}
            words = f"{DELAY} scans later {later:.3f}, {100 * later_iou:.1f}"
            show_line(f"belief, {', '.join(names)}: threshold {threshold:.3f}, moving IoU {100 * iou:.1f}; {words}")
    training = {
        "decisions": decisions,
        "tuned": asdict(tuned),
        "postprocess": postprocess or found.config.postprocess,
        "trained": True,
        "data": data or data_of(found.training),
        "licence": licence,
        "step": found.training.get("step"),
    }
    config = found.config if name is None else replace(found.config, name=name)
    out.parent.mkdir(parents=True, exist_ok=True)
    save(out, config, found.image_net, found.point_head, training, half=True)
    show_line(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    sys.exit(run_alone(publish, "publish"))

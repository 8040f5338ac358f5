"""Commands of the street simulator: `mos demo` and `mos simulate`. What is heavy is imported when they run."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from runtime.commands.options import Bundle, StreetSensor, Threads, opened_sensor
from runtime.commands.output import show_facts, show_line
from runtime.sensors.registry import DEFAULT_SENSOR

if TYPE_CHECKING:
    from mos_model.simulator.demo import Demo


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the street, the predictions and pictures.")] = Path("demo"),
    scans: Annotated[int, typer.Option(min=1, help="Scans to simulate.")] = 30,
    bundle: Bundle = None,
    threads: Threads = 2,
) -> None:
    """See the main job in a minute: simulate a street, find what moves in it, draw it."""
    from mos_model.simulator.demo import run_demo
    from runtime.commands.progress import stages

    with stages() as report:
        done = run_demo(out, scans, bundle, threads, report)
    show_demo(done)


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New folder for sequences/NN.")],
    sequences: Annotated[int, typer.Option(min=1, help="Streets.")] = 1,
    frames: Annotated[int, typer.Option(min=1, help="Scans of each.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same data.")] = 0,
    sensor: StreetSensor = DEFAULT_SENSOR,
    street: Annotated[str, typer.Option(help="A kind of street or room, or random.")] = "random",
    version: Annotated[int, typer.Option(help="1: a car in streets. 2: robots, rooms, weather, many people too.")] = 1,
    weather: Annotated[str, typer.Option(help="clear, fog, rain, snow, dust, or random.")] = "random",
) -> None:
    """Write simulated streets with labels and poses, in SemanticKITTI's layout."""
    profile = opened_sensor(sensor)

    from mos_model.simulator.write import write_dataset
    from runtime.commands.progress import counted

    with counted("scans") as progress:
        chosen = {"street": street, "version": version, "weather": weather}
        done = write_dataset(out, sequences, frames, seed, profile, progress, **chosen)
    show_line(
        f"{done.path}: {done.scans} scans in {done.sequences} sequences, "
        f"{done.points / done.scans:,.0f} points a scan, "
        f"{100 * done.moving_points / max(done.points, 1):.2f} % of them moving"
    )


def show_demo(demo: "Demo") -> None:
    """What was found and how fast, where the pictures are, and what to try next."""
    import numpy as np

    scores, summary = demo.scores, demo.summary
    milliseconds = 1000 * np.asarray(summary.latency["scan"])
    median, p95 = np.percentile(milliseconds, [50, 95])
    points = summary.points / summary.scans
    rows = {
        "moving points": f"IoU {_share(scores.iou)}, precision {_share(scores.precision)}, "
        f"recall {_share(scores.recall)} of {summary.scans} scans of one street",
        "a scan": f"{median:.0f} ms (95th percentile {p95:.0f} ms) for {points:,.0f} points, read and written",
        "scans a second": f"{1000 / milliseconds.mean():.1f}",
        "pictures": " ".join(map(str, demo.pictures)) or demo.no_pictures,
        "labels": str(summary.folder),
        "all of it": f"{demo.seconds:.0f} s",
    }
    show_facts(rows)
    out = demo.sequence.parents[2]
    show_line("next:", style="bold")
    for command, what in (
        ("mos doctor YOUR_SEQUENCE", "does your data fit? (KITTI layout, or a folder of scans with poses.txt)"),
        ("mos run YOUR_SEQUENCE", "a label for every point of it"),
        ("mos view YOUR_SEQUENCE --predictions predictions --out it.gif", "look at them"),
        (f"mos eval {out / 'predictions'} {out / 'street'}", "the scores above by range and class"),
    ):
        show_line(f"  {command}")
        show_line(f"      {what}", style="dim")


def _share(value: float) -> str:
    return "undefined (nothing moves)" if math.isnan(value) else f"{100 * value:.1f} %"

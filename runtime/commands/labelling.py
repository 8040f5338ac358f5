"""What `mos run` and `mos clean` do with each recording: find poses, label, write what is left, and say so."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.table import Table

from runtime.commands.handler import is_interrupt
from runtime.commands.output import Terminal, say, show_line
from runtime.commands.recordings import with_found_poses
from runtime.errors import MosWarning, some

if TYPE_CHECKING:
    from runtime.predict import Output, Summary
    from runtime.recordings.recording import Indexed, Options
    from runtime.runner import MosRunner
    from runtime.sensors.range_image import RangeImage


@dataclass(frozen=True)
class Wanted:
    """What is to be written beside the labels."""

    cloud: bool = False  # clouds in which each point says whether it moves
    clean: bool = False  # the recording without what moves
    map: bool = False  # a point for each voxel in which something stands still
    bag: bool = False  # a copy of a bag in which each point says whether it moves
    picture: bool = False  # of the map from above, where Pillow is installed
    form: str | None = None  # of clouds; None: PLY, and of clean ones the recording's own
    voxel: float = 0.1  # m


@contextmanager
def interruptible() -> Iterator[None]:
    """Within, an interrupt is said, and ends the command with 130."""
    try:
        yield
    except (KeyboardInterrupt, SystemError) as error:
        if not is_interrupt(error):
            raise
        say("interrupted. Finished predictions are kept; the same command goes on from there")
        raise typer.Exit(130) from None


def label(
    given: "Indexed", runner: "MosRunner", options: "Options", out: Path, *, overwrite: bool, wanted: Wanted
) -> None:
    """All of it, of one recording."""
    from runtime.cleaning.labelled_bag import Probabilities
    from runtime.cleaning.labelled_clouds import LabelledClouds
    from runtime.doctor.sensor_of import in_own_frame, sensor_of
    from runtime.predict import predictions_folder

    if wanted.bag:
        given.check_takes_labels()  # before anything is labelled
    labels = predictions_folder(out, given)
    recording = with_found_poses(given, options, labels.parent)
    outputs: list[Output] = []
    if wanted.cloud:
        outputs.append(LabelledClouds(labels.with_name("clouds"), wanted.form or "ply"))
    if wanted.bag:
        outputs.append(Probabilities(labels.with_name("probabilities")))
    chosen = sensor_of(recording, runner.bundle.manifest, runner.settings.profile)
    told = _warn_of_misfits(in_own_frame(recording, chosen), chosen.entry.range_image, options.skip_broken)
    with warnings.catch_warnings():
        for topic in told:
            warnings.filterwarnings("ignore", f"{topic}: ", MosWarning)  # the runner's own word on it
        summary = predict_with_progress(recording, runner, out, overwrite, options.skip_broken, outputs)
    show_summary(recording.name, summary)
    if wanted.cloud:
        show_line(f"clouds: {labels.with_name('clouds')}")
    if wanted.bag:
        write_bag(recording, labels)
    if wanted.clean or wanted.map:
        write_left(recording, labels, wanted)


def write_bag(recording: "Indexed", labels: Path) -> None:
    """A copy of the bag that a recording is from, with labels, beside the folder of its labels."""
    from runtime.cleaning.labelled_bag import Probabilities, write_labelled_bag
    from runtime.commands.progress import counted

    folder = labels.with_name("bag")
    with counted(f"{recording.name} with labels") as progress:
        count = write_labelled_bag(
            recording, labels, Probabilities(labels.with_name("probabilities")), folder, progress
        )
    show_line(f"bag with labels: {folder}, {count} clouds")


def write_left(recording: "Indexed", labels: Path, wanted: Wanted) -> None:
    """The static map, and the recording without what moves, beside the folder of its labels."""
    from runtime.cleaning.cleaning import CLEAN, SAME, write_clean, write_maps
    from runtime.cleaning.votes import RecordingVotes
    from runtime.commands.progress import counted
    from runtime.compute.packages import PILLOW, has_package
    from runtime.doctor.findings import percent

    with counted(f"what moves in {recording.name}") as progress:
        votes = RecordingVotes(recording, labels, wanted.voxel, progress)
    if wanted.map:
        for path, points in write_maps(votes, labels.parent).items():
            show_line(f"static map: {path}, {points:,} points")
        if wanted.picture and has_package(PILLOW):
            from runtime.pictures.map_view import draw_map

            picture = labels.with_name("map.png")
            first = votes.stretches[0].votes
            draw_map(picture, first.static_map().points, first.moving_places())
            show_line(f"from above, before and after: {picture}")
    if wanted.clean:
        with counted(f"{recording.name} without it") as progress:
            left = write_clean(votes, labels.with_name(CLEAN), wanted.form or SAME, progress)
        share = percent(1 - left.kept / max(1, left.points))
        show_line(f"without what moves: {left.folder}, {left.scans} scans, {share} of the points left out")


def _warn_of_misfits(recording: "Indexed", image: "RangeImage", skip_broken: bool) -> set[str]:
    """Say on stderr what makes the labels of a recording worthless, such as poses in another frame; its topics.

    skip_broken: not what is broken, which is said at the end.
    """
    from runtime.doctor.diagnose import diagnose

    bad = [finding for finding in diagnose(recording, image) if finding.level == "bad"]
    told = [finding for finding in bad if not (skip_broken and finding.topic in ("scans", "poses"))]
    for finding in told:
        say(f"{recording.source}: {finding.topic}: {finding.text}. The labels will be wrong")
    return {finding.topic for finding in told}


def predict_with_progress(
    recording: "Indexed",
    runner: "MosRunner",
    out: Path,
    overwrite: bool,
    skip_broken: bool,
    outputs: "Sequence[Output]",
) -> "Summary":
    """`predict` with a bar: scans done, scans per second, time left."""
    from runtime.commands.progress import counted
    from runtime.predict import predict

    with counted(f"sequence {recording.name}") as progress:
        return predict(
            recording,
            runner,
            out,
            overwrite=overwrite,
            skip_broken=skip_broken,
            outputs=outputs,
            on_progress=progress,
        )


def show_summary(name: str, summary: "Summary") -> None:
    """What was done, how long a scan took, and where the predictions are."""
    import numpy as np

    from runtime.doctor.findings import percent

    already = f", {summary.resumed} were there already" if summary.resumed else ""
    anew = f", {summary.anew} of them anew: they, or scans that their labels depend on, have changed"
    show_line(f"sequence {name}: {summary.scans} scans{already}{anew if summary.anew else ''}")
    if summary.scans:
        share = percent(summary.moving / max(1, summary.points))
        show_line(f"{summary.points:,} points, {share} moving")
        table = Table("ms a scan", box=None, pad_edge=False)
        for column in ("median", "p95"):
            table.add_column(column, justify="right")
        for stage, seconds in summary.latency.items():
            median, p95 = np.percentile(1000 * np.asarray(seconds), [50, 95])
            table.add_row(stage, f"{median:.1f}", f"{p95:.1f}", style="bold" if stage == "scan" else "")
        Terminal().print(table)
    show_line(f"predictions: {summary.folder}")
    if summary.broken:
        reasons = some([f"{key} ({reason})" for key, reason in summary.broken.items()])
        say(f"sequence {name}: broken scans, left without a label: {len(summary.broken)}: {reasons}")

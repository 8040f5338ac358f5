"""`mos run`: the main job."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from runtime.commands.handler import is_interrupt
from runtime.commands.options import Bundle, Calib, Frame, Input, Names, Poses, Threads
from runtime.errors import SettingError

if TYPE_CHECKING:
    from runtime.predict import Summary
    from runtime.recordings.sequence import Sequence
    from runtime.runner import MosRunner
    from runtime.sensors.range_image import RangeImage


class Postprocess(StrEnum):
    """What turns the image network's classes into those of points."""

    NONE = "none"
    KNN = "knn"
    HEAD = "head"


def run(
    path: Input,
    out: Annotated[Path, typer.Option(help="Folder for sequences/NN/predictions/*.label.")] = Path("predictions"),
    bundle: Bundle = None,
    threads: Threads = 2,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Only the first scans of a sequence.", show_default="all")
    ] = None,
    sequence: Names = None,
    poses: Poses = None,
    pose_frame: Frame = None,
    calib: Calib = None,
    postprocess: Annotated[
        Postprocess | None, typer.Option(help="From pixels to points.", show_default="the bundle's")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace predictions instead of continuing them.")
    ] = False,
) -> None:
    """Label every point of a sequence: 251 moving, 9 everything else, in SemanticKITTI's layout.

    An interrupted run goes on where it was when the same command is given again.
    """
    from runtime.recordings.sequence import find_sequences, open_sequence

    folders = find_sequences(path, tuple(sequence or ()))
    if len(folders) > 1 and (poses or calib):
        raise SettingError(f"--poses and --calib are for one sequence, not for {len(folders)}; pick one by --sequence")
    sequences = [open_sequence(folder, poses, calib, pose_frame, limit) for folder in folders]

    from runtime.runner import MosRunner

    try:
        runner = MosRunner(bundle, threads=threads, postprocess=postprocess.value if postprocess else None)
        for folder, one in zip(folders, sequences, strict=True):
            _warn_of_misfits(folder, runner.bundle.manifest.sensor.range_image, poses, calib, pose_frame)
            show_summary(one.name, predict_with_progress(one, runner, out, overwrite))
    except (KeyboardInterrupt, SystemError) as error:
        if not is_interrupt(error):
            raise
        typer.echo("mos: interrupted. Finished predictions are kept; the same command goes on from there", err=True)
        raise typer.Exit(130) from None


def _warn_of_misfits(
    folder: Path, sensor: "RangeImage", poses: Path | None, calib: Path | None, pose_frame: str | None
) -> None:
    """Say on stderr what makes the labels of a sequence worthless, such as poses in another frame."""
    from runtime.doctor.diagnose import diagnose

    for finding in diagnose(folder, sensor, poses, calib, pose_frame):
        if finding.level == "bad":
            typer.echo(f"mos: {folder}: {finding.topic}: {finding.text}. The labels will be wrong", err=True)


def predict_with_progress(sequence: "Sequence", runner: "MosRunner", out: Path, overwrite: bool) -> "Summary":
    """`predict` with a bar: scans done, scans per second, time left."""
    from runtime.commands.progress import counted
    from runtime.predict import predict

    with counted(f"sequence {sequence.name}") as progress:
        return predict(sequence, runner, out, overwrite=overwrite, on_progress=progress)


def show_summary(name: str, summary: "Summary") -> None:
    """What was done, how long a scan took, and where the predictions are."""
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from runtime.doctor.findings import percent

    console = Console(highlight=False, markup=False)
    already = f", {summary.resumed} were there already" if summary.resumed else ""
    console.print(f"sequence {name}: {summary.scans} scans{already}")
    if summary.scans:
        share = percent(summary.moving / max(1, summary.points))
        console.print(f"{summary.points:,} points, {share} moving")
        table = Table("ms a scan", box=None, pad_edge=False)
        for column in ("median", "p95"):
            table.add_column(column, justify="right")
        for stage, seconds in summary.latency.items():
            median, p95 = np.percentile(1000 * np.asarray(seconds), [50, 95])
            table.add_row(stage, f"{median:.1f}", f"{p95:.1f}", style="bold" if stage == "scan" else "")
        console.print(table)
    console.print(f"predictions: {summary.folder}", soft_wrap=True)

"""`mos run`: the main job."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from runtime.commands.handler import is_interrupt
from runtime.commands.options import (
    Bundle,
    Calib,
    Columns,
    Extrinsics,
    Frame,
    Input,
    Names,
    NoDeskew,
    Odometry,
    OwnSensor,
    Poses,
    PoseTopic,
    RemissionScale,
    Threads,
    Topic,
    wrong_usage,
)
from runtime.commands.output import Terminal, say, show_line
from runtime.commands.recordings import recording_options, with_found_poses
from runtime.commands.runner_options import (
    DEFAULTS,
    Belief,
    Body,
    Delay,
    Fallback,
    HeadEngine,
    Nearest,
    Postprocess,
    Precision,
    Providers,
    Refine,
    SessionOptions,
    corners,
    key_value,
    provider,
    runner_settings,
)
from runtime.errors import MosWarning, some

if TYPE_CHECKING:
    from runtime.predict import Summary
    from runtime.recordings.recording import Indexed
    from runtime.runner import MosRunner
    from runtime.sensors.range_image import RangeImage


def run(
    path: Input,
    out: Annotated[Path, typer.Option(help="Folder for sequences/NN/predictions/*.label.")] = Path("predictions"),
    bundle: Bundle = None,
    sensor: OwnSensor = None,
    threads: Threads = 2,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Only the first scans of a sequence.", show_default="all")
    ] = None,
    names: Names = None,
    poses: Poses = None,
    frame: Frame = None,
    calib: Calib = None,
    extrinsics: Extrinsics = None,
    topic: Topic = None,
    pose_topic: PoseTopic = None,
    columns: Columns = None,
    remission_scale: RemissionScale = None,
    odometry: Odometry = None,
    no_deskew: NoDeskew = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace predictions instead of continuing them.")
    ] = False,
    skip_broken: Annotated[
        bool,
        typer.Option("--skip-broken", help="Leave scans that cannot be read, or have a broken pose, without a label."),
    ] = False,
    postprocess: Postprocess = None,
    refine: Refine = None,
    head_engine: HeadEngine = None,
    precision: Precision = DEFAULTS.precision,
    belief: Belief = DEFAULTS.belief,
    delay: Delay = DEFAULTS.delay,
    nearest: Nearest = DEFAULTS.nearest,
    body: Body = None,
    providers: Providers = None,
    allow_fallback: Fallback = False,
    session_options: SessionOptions = None,
) -> None:
    """Label every point of a sequence: 251 moving, 9 everything else, in SemanticKITTI's layout.

    An interrupted run goes on where it was when the same command is given again.
    """
    settings = runner_settings(
        threads=threads,
        postprocess=postprocess,
        refine=refine or DEFAULTS.refine,
        head_engine=head_engine or DEFAULTS.head_engine,
        precision=precision,
        belief=belief,
        delay=delay,
        deskew=not no_deskew,
        sensor=sensor,
        nearest=nearest,
        body=None if body is None else corners(body),
        providers=[provider(text) for text in providers or ()] or None,
        allow_fallback=allow_fallback,
        session_options=dict(key_value(text) for text in session_options or ()),
    )

    options = recording_options(
        odometry,
        no_deskew,
        poses=poses,
        calib=calib,
        frame=frame,
        limit=limit,
        topic=topic,
        pose_topic=pose_topic,
        extrinsics=extrinsics,
        columns=columns,
        remission_scale=remission_scale,
        skip_broken=skip_broken,
    )

    from runtime.recordings.registry import open_recordings

    with wrong_usage():
        recordings = open_recordings(path, tuple(names or ()), options)

    from runtime.doctor.sensor_of import in_own_frame, sensor_of
    from runtime.predict import predictions_folder
    from runtime.runner import MosRunner

    try:
        runner = MosRunner(bundle, settings=settings)
        if (refine or head_engine) and runner.postprocess != "head":
            raise typer.BadParameter(
                f"--refine and --head-engine are for the point head, not for --postprocess {runner.postprocess}"
            )
        for given in recordings:
            recording = with_found_poses(given, options, predictions_folder(out, given).parent)
            chosen = sensor_of(recording, runner.bundle.manifest, settings.profile)
            told = _warn_of_misfits(in_own_frame(recording, chosen), chosen.entry.range_image, skip_broken)
            with warnings.catch_warnings():
                for topic in told:
                    warnings.filterwarnings("ignore", f"{topic}: ", MosWarning)  # the runner's own word on it
                show_summary(recording.name, predict_with_progress(recording, runner, out, overwrite, skip_broken))
    except (KeyboardInterrupt, SystemError) as error:
        if not is_interrupt(error):
            raise
        say("interrupted. Finished predictions are kept; the same command goes on from there")
        raise typer.Exit(130) from None


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
    recording: "Indexed", runner: "MosRunner", out: Path, overwrite: bool, skip_broken: bool
) -> "Summary":
    """`predict` with a bar: scans done, scans per second, time left."""
    from runtime.commands.progress import counted
    from runtime.predict import predict

    with counted(f"sequence {recording.name}") as progress:
        return predict(recording, runner, out, overwrite=overwrite, skip_broken=skip_broken, on_progress=progress)


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

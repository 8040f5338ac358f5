"""`mos run`: the main job."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from runtime.commands.options import (
    Bundle,
    Calib,
    Columns,
    Extrinsics,
    Frame,
    Inputs,
    Names,
    NoDeskew,
    Odometry,
    OwnSensor,
    Poses,
    PoseTopic,
    RemissionScale,
    Threads,
    Topic,
    World,
    wrong_usage,
)
from runtime.commands.recordings import recording_options
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
from runtime.commands.summary import interruptible, show_summary
from runtime.commands.terminal_voice import TerminalVoice
from runtime.commands.written import Format, Voxel, Write, wanted_of

if TYPE_CHECKING:
    from runtime.fleet.plan import Way

LOCAL, RAY = "local", "ray"


def run(
    paths: Inputs,
    out: Annotated[
        str, typer.Option(metavar="FOLDER", help="Folder for sequences/NN/predictions/*.label, or s3://BUCKET/KEY.")
    ] = "predictions",
    bundle: Bundle = None,
    sensor: OwnSensor = None,
    threads: Threads = 2,
    jobs: Annotated[
        int, typer.Option(min=1, help="Recordings at a time, each in a process with its share of the threads.")
    ] = 1,
    on: Annotated[
        str,
        typer.Option(
            metavar="local|ray|ray://HOST:PORT", help="This machine, or a cluster of Ray: a task for each recording."
        ),
    ] = LOCAL,
    piece: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Label recordings of more scans than this in pieces of so many, each as a task of its own.",
            show_default="whole",
        ),
    ] = None,
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
    world: World = None,
    columns: Columns = None,
    remission_scale: RemissionScale = None,
    odometry: Odometry = None,
    no_deskew: NoDeskew = False,
    write: Annotated[
        list[Write] | None,
        typer.Option(
            help="Beside labels, cloud: clouds with fields moving and probability; static: the recording without what "
            "moves; map: a static map; bag: a copy of a bag whose clouds have these fields. May be repeated.",
            show_default="label",
        ),
    ] = None,
    format: Format = None,
    voxel: Voxel = None,
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
    """Label every point of recordings: 251 moving, 9 everything else, in SemanticKITTI's layout.

    An interrupted run goes on where it was when the same command is given again. Of several recordings one that is
    broken does not stop the others.
    """
    if not (on in (LOCAL, RAY) or (on.startswith(f"{RAY}://") and len(on) > len(f"{RAY}://"))):
        raise typer.BadParameter(f"--on is local, ray or ray://HOST:PORT, not {on!r}")
    if on != LOCAL and jobs > 1:
        raise typer.BadParameter(
            "--jobs is for this machine: Ray itself says how many recordings are labelled at a time"
        )
    wanted = wanted_of({one.value for one in write or ()}, format, voxel)
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
        world=world,
        extrinsics=extrinsics,
        columns=columns,
        remission_scale=remission_scale,
        skip_broken=skip_broken,
    )

    from runtime.bundle.loading import load_bundle
    from runtime.fleet.remote import place_of
    from runtime.fleet.store import find_places
    from runtime.recordings.registry import check_count, open_recording

    with wrong_usage():
        results = place_of(out)
        found = find_places(paths, tuple(names or ()))
        check_count(len(found), options)
        given = found[0] if len(found) == 1 else None
        recording = open_recording(given, options) if isinstance(given, Path) else None
    points = settings.postprocess or load_bundle(bundle).manifest.postprocess
    if (refine or head_engine) and points != "head":
        raise typer.BadParameter(f"--refine and --head-engine are for the point head, not for --postprocess {points}")

    alone = on == LOCAL and jobs == 1 and piece is None
    if alone and recording is not None and isinstance(results, Path):
        from runtime.fleet.labelling import label
        from runtime.runner import MosRunner

        with interruptible(), MosRunner(bundle, settings=settings) as runner:
            summary = label(recording, runner, options, results, overwrite, wanted, TerminalVoice())
        show_summary(recording.name, summary)
        return

    from runtime.commands.several import label_several
    from runtime.fleet.work import settle

    with interruptible():
        label_several(found, settle(bundle, settings, options, results, overwrite, wanted, piece), _way(on, jobs))


def _way(on: str, jobs: int) -> "Way":
    """How several recordings are labelled."""
    from runtime.fleet.here import label_here
    from runtime.fleet.on_ray import label_on_ray
    from runtime.fleet.processes import label_in_processes

    if on != LOCAL:
        return partial(label_on_ray, address=None if on == RAY else on)
    return label_here if jobs == 1 else partial(label_in_processes, jobs=jobs)

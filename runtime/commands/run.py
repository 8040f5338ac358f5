"""`mos run`: the main job."""

from pathlib import Path
from typing import Annotated

import typer

from runtime.commands.labelling import interruptible, label
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
from runtime.commands.written import Format, Voxel, Write, wanted_of


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
    world: World = None,
    columns: Columns = None,
    remission_scale: RemissionScale = None,
    odometry: Odometry = None,
    no_deskew: NoDeskew = False,
    write: Annotated[
        list[Write] | None,
        typer.Option(
            help="Beside labels, cloud: clouds with fields moving and probability; clean: the recording without what "
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
    """Label every point of a sequence: 251 moving, 9 everything else, in SemanticKITTI's layout.

    An interrupted run goes on where it was when the same command is given again.
    """
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

    from runtime.recordings.registry import open_recordings

    with wrong_usage():
        recordings = open_recordings(path, tuple(names or ()), options)

    from runtime.runner import MosRunner

    with interruptible(), MosRunner(bundle, settings=settings) as runner:
        if (refine or head_engine) and runner.postprocess != "head":
            raise typer.BadParameter(
                f"--refine and --head-engine are for the point head, not for --postprocess {runner.postprocess}"
            )
        for recording in recordings:
            label(recording, runner, options, out, overwrite=overwrite, wanted=wanted)

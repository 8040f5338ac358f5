"""`mos clean`: a recording without what moves in it, and a static map."""

from pathlib import Path
from typing import Annotated

import typer

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
from runtime.commands.runner_options import DEFAULTS, Body, Delay, Nearest, corners, runner_settings
from runtime.commands.summary import interruptible, show_summary
from runtime.commands.terminal_voice import TerminalVoice
from runtime.commands.written import Format, Voxel, Write, wanted_of

DELAY = 10  # scans


def clean(
    path: Input,
    out: Annotated[Path, typer.Option(help="Folder for sequences/NN/{clean, map.ply, ...}.")] = Path("cleaned"),
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
    format: Format = None,
    voxel: Voxel = None,
    delay: Delay = DELAY,
    nearest: Nearest = DEFAULTS.nearest,
    body: Body = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace labels instead of continuing them.")] = False,
    skip_broken: Annotated[
        bool, typer.Option("--skip-broken", help="Leave out scans that cannot be read, or have a broken pose.")
    ] = False,
) -> None:
    """Write clean clouds, or a clean bag, without what moves, and a static map with a picture of it.

    Labels come first, those of `mos run --delay 10`. Then all scans vote on each voxel whether it moves there, and
    rays must have gone through it.
    """
    wanted = wanted_of({Write.STILL, Write.MAP}, format, voxel, picture=True)
    settings = runner_settings(
        sensor=sensor,
        threads=threads,
        delay=delay,
        nearest=nearest,
        body=None if body is None else corners(body),
        deskew=not no_deskew,
        providers=None,
        allow_fallback=False,
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

    from runtime.fleet.labelling import label
    from runtime.runner import MosRunner

    with interruptible(), MosRunner(bundle, settings=settings) as runner:
        for recording in recordings:
            show_summary(recording.name, label(recording, runner, options, out, overwrite, wanted, TerminalVoice()))

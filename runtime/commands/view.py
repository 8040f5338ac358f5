"""`mos view`: pictures of what moves."""

import os
import sys
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
    NoDeskew,
    Odometry,
    OwnSensor,
    Poses,
    PoseTopic,
    RemissionScale,
    Topic,
    World,
    opened_sensor,
    wrong_usage,
)
from runtime.commands.output import show_line
from runtime.commands.recordings import recording_options, with_found_poses
from runtime.commands.runner_options import DEFAULTS, Body, Nearest, corners
from runtime.errors import SettingError

LEAD = 40  # scans before the first that is shown: those that its labels depend on, and some to find the poses by


def view(
    path: Input,
    predictions: Annotated[
        Path | None,
        typer.Option(help="Root or folder of .label files, of any tool.", show_default="what the bundle says now"),
    ] = None,
    compare: Annotated[
        Path | None, typer.Option(help="The same of a second system, shown beside the first.", show_default=False)
    ] = None,
    scan: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Position of the scan in the sequence, from 0; the first one of a .gif or .rrd.",
            show_default="middle of the sequence; 0",
        ),
    ] = None,
    count: Annotated[int | None, typer.Option(min=1, help="Scans of a .gif or .rrd.", show_default="30")] = None,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Picture .png, animation .gif, or 3D recording .rrd for Rerun.")
    ] = Path("view.png"),
    show: Annotated[
        bool, typer.Option("--show", help="Play the recording in Rerun's viewer while it is made.")
    ] = False,
    bundle: Bundle = None,
    sensor: OwnSensor = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads to use.", show_default="2")] = None,
    name: Annotated[
        str | None, typer.Option("--sequence", help="Sequence under a root.", show_default="the only one")
    ] = None,
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
    nearest: Nearest = DEFAULTS.nearest,
    body: Body = None,
) -> None:
    """Draw what moves: found, missed and false movers where there are labels (extra 'view')."""
    suffix = out.suffix.lower()
    if count is not None and suffix == ".png":
        raise typer.BadParameter(f"--count is for a .gif or .rrd, and {out} shows one scan, chosen by --scan")
    if show and suffix != ".rrd":
        raise typer.BadParameter(f"--show opens 3D recordings, and {out} is none: let --out end with .rrd")
    if predictions is not None and (bundle, sensor, threads, body, nearest) != (
        None,
        None,
        None,
        None,
        DEFAULTS.nearest,
    ):
        raise typer.BadParameter(
            "--bundle, --sensor, --threads, --nearest and --body are for what a bundle says now, and --predictions are "
            "there"
        )
    box = None if body is None else corners(body)
    given = None if sensor is None else opened_sensor(sensor)

    from runtime.commands.progress import counted
    from runtime.pictures import check_output
    from runtime.pictures.drawing import choose_scans, draw
    from runtime.recordings.registry import open_recording

    options = recording_options(
        odometry,
        no_deskew,
        poses=poses,
        calib=calib,
        frame=frame,
        topic=topic,
        pose_topic=pose_topic,
        world=world,
        extrinsics=extrinsics,
        columns=columns,
        remission_scale=remission_scale,
    )
    with wrong_usage():
        opened = open_recording(path, options, name)
    check_output(out)
    if show:
        check_display(out)
    shown = choose_scans(opened, suffix, scan, count)
    opened = with_found_poses(opened, options, chosen=range(max(0, shown.start - LEAD), shown.stop))
    with counted("scans") as progress:
        draw(
            opened,
            out,
            predictions=predictions,
            compare=compare,
            scan=scan,
            count=count,
            bundle=bundle,
            sensor=given,
            threads=threads or 2,
            deskew=not no_deskew,
            nearest=nearest,
            body=box,
            show=show,
            on_progress=progress,
        )
    show_line(str(out))


def check_display(recording: str | Path) -> None:
    """Raises SettingError where Rerun's viewer has no screen."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SettingError(
            f"there is no display for Rerun's viewer: leave out --show, and open the file elsewhere: rerun {recording}"
        )

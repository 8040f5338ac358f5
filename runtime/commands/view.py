"""`mos view`: pictures of what moves."""

from pathlib import Path
from typing import Annotated

import typer

from runtime.commands.options import Bundle, Calib, Frame, Input, Poses, Threads


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
    count: Annotated[int, typer.Option(min=1, help="Scans of a .gif or .rrd.")] = 30,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Picture .png, animation .gif, or 3D recording .rrd for Rerun.")
    ] = Path("view.png"),
    show: Annotated[bool, typer.Option("--show", help="Open the recording in Rerun's viewer.")] = False,
    bundle: Bundle = None,
    threads: Threads = 2,
    sequence: Annotated[str | None, typer.Option(help="Sequence under a root.", show_default="the only one")] = None,
    poses: Poses = None,
    pose_frame: Frame = None,
    calib: Calib = None,
) -> None:
    """Draw what moves: found, missed and false movers where there are labels (extra 'view')."""
    from runtime.commands.progress import counted
    from runtime.pictures import check_output
    from runtime.pictures.command import check_viewer, open_viewer
    from runtime.pictures.command import view as draw
    from runtime.recordings.recording import Options
    from runtime.recordings.registry import open_recording

    check_output(out)
    if show:
        check_viewer(out)
    opened = open_recording(path, Options(poses, calib, pose_frame), sequence)
    with counted("scans") as progress:
        draw(
            opened,
            out,
            predictions=predictions,
            compare=compare,
            scan=scan,
            count=count,
            bundle=bundle,
            threads=threads,
            on_progress=progress,
        )
    typer.echo(str(out))
    if show:
        open_viewer(out)

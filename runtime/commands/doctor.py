"""`mos doctor`: what does not fit in a recording, in plain words."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from runtime.commands.options import Bundle, Calib, Frame, Input, Names, Poses
from runtime.errors import BundleError

if TYPE_CHECKING:
    from runtime.doctor.findings import Finding
    from runtime.sensors.range_image import RangeImage

COLOURS = {"ok": "green", "warn": "yellow", "bad": "red"}


def doctor(
    path: Input,
    bundle: Bundle = None,
    sequence: Names = None,
    poses: Poses = None,
    pose_frame: Frame = None,
    calib: Calib = None,
) -> None:
    """Look at scans and poses and say in plain words what does not fit. Exit code 1 if anything is bad."""
    from runtime.doctor.diagnose import examine
    from runtime.recordings.recording import Options
    from runtime.recordings.registry import find_recordings

    found = find_recordings(path, tuple(sequence or ()))
    options, sensor = Options(poses, calib, pose_frame), _sensor(bundle)
    bad = False
    for one in found:
        findings = examine(one, sensor, options)
        show_findings(one.path, findings)
        bad |= any(finding.level == "bad" for finding in findings)
    raise typer.Exit(1 if bad else 0)


def show_findings(folder: Path, findings: list["Finding"]) -> None:
    """A line a finding, and how many are not ok."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False, markup=False)
    table = Table(box=None, show_header=False, pad_edge=False)
    for finding in findings:
        table.add_row(Text(finding.level, style=COLOURS[finding.level]), Text(finding.topic), Text(finding.text))
    bad, warn = (sum(finding.level == level for finding in findings) for level in ("bad", "warn"))
    console.print(f"{folder}", soft_wrap=True)
    console.print(table)
    console.print(f"{bad} bad, {warn} to look at" if bad or warn else "all well")


def _sensor(bundle: Path | None) -> "RangeImage | None":
    """The sensor that the bundle was made for; None where no bundle is given and none is installed."""
    from runtime.bundle.loading import load_bundle

    try:
        return load_bundle(bundle).manifest.sensor.range_image
    except BundleError:
        if bundle is not None:
            raise
        typer.echo("mos: no bundle is installed: the sensor is not compared with any (--bundle)", err=True)
        return None

"""`mos doctor`: what does not fit in a recording, in plain words."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.text import Text

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
    Topic,
    World,
    opened_sensor,
    wrong_usage,
)
from runtime.commands.output import say, show_line, show_rows, worded
from runtime.commands.recordings import recording_options, with_found_poses
from runtime.errors import BundleError
from runtime.sensors.sensor import Sensor

if TYPE_CHECKING:
    from runtime.bundle.choice import Choice
    from runtime.doctor.findings import Finding
    from runtime.recordings.recording import Indexed

COLOURS = {"ok": "green", "warn": "yellow", "bad": "red"}


def doctor(
    path: Input,
    bundle: Bundle = None,
    sensor: OwnSensor = None,
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
) -> None:
    """Look at scans and poses and say in plain words what does not fit. Exit code 1 if anything is bad."""
    given = None if sensor is None else opened_sensor(sensor)
    from runtime.doctor.diagnose import examine
    from runtime.recordings.registry import check_options, find_recordings

    found = find_recordings(path, tuple(names or ()))
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
        check_options(found, options)
    choose = _chooser(bundle, given)
    bad = False
    for one in found:
        findings = examine(one, choose, options, lambda given: with_found_poses(given, options))
        show_findings(one.path, findings)
        bad |= any(finding.level == "bad" for finding in findings)
    raise typer.Exit(1 if bad else 0)


def show_findings(folder: Path, findings: list["Finding"]) -> None:
    """A line a finding, and how many are not ok."""
    show_line(str(folder))
    show_rows((Text(one.level, style=COLOURS[one.level]), one.topic, worded(one.text)) for one in findings)
    bad, warn = (sum(finding.level == level for finding in findings) for level in ("bad", "warn"))
    show_line(f"{bad} bad, {warn} to look at" if bad or warn else "all well")


def _chooser(bundle: Path | None, given: Sensor | None) -> "Callable[[Indexed], Choice] | None":
    """What tells the sensor that a bundle takes scans for; None where no bundle is given, and none is installed."""
    from runtime.bundle.loading import load_bundle
    from runtime.doctor.sensor_of import sensor_of

    try:
        manifest = load_bundle(bundle).manifest
    except BundleError:
        if bundle is not None:
            raise
        say("no bundle is installed: the sensor is not compared with any (`bundle`)")
        return None
    return partial(sensor_of, manifest=manifest, given=given)

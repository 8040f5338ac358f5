"""How commands open recordings: given poses, or those that are found."""

from typing import TYPE_CHECKING, Any

import typer

from runtime.commands.options import OdometryName, wrong_usage

if TYPE_CHECKING:
    from runtime.recordings.recording import Indexed, Options


def recording_options(odometry: OdometryName | None, no_deskew: bool, **given: Any) -> "Options":
    """The options of a recording, by their names, of which none is wrong or would be ignored."""
    from runtime.compute.packages import KISS_ICP, has_package
    from runtime.recordings.recording import Options

    if given["frame"] == "lidar" and given["calib"] is not None:
        raise typer.BadParameter("poses of the LiDAR (--pose-frame lidar) need no --calib: leave out one of the two")
    named = any(given[name] for name in ("poses", "pose_topic", "world", "calib", "frame", "extrinsics"))
    if odometry is OdometryName.KISS and named:
        raise typer.BadParameter("--odometry kiss finds the poses: leave it out, or what says which poses are given")
    if odometry is None:
        poses = "optional" if has_package(KISS_ICP) and not named else "needed"
    else:
        poses = "ignored" if odometry is OdometryName.KISS else "needed"
    with wrong_usage():
        return Options(**given, given_poses=poses, deskew=not no_deskew)


def with_found_poses(recording: "Indexed", options: "Options", chosen: range | None = None) -> "Indexed":
    """The recording, with poses by odometry where it has none; see `with_poses`. With a bar."""
    from runtime.commands.progress import counted
    from runtime.odometry.with_poses import with_poses

    if recording.poses is not None:
        return recording
    with counted(f"poses of {recording.name}") as progress:
        return with_poses(recording, chosen=chosen, deskew=options.deskew, on_progress=progress)

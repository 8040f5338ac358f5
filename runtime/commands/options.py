"""Options that several commands have: each is written once."""

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from runtime.commands.output import printable, worded
from runtime.errors import SettingError
from runtime.sensors.registry import SENSORS, open_sensor
from runtime.sensors.sensor import Sensor


class PoseFrame(StrEnum):
    """Whose poses a file holds."""

    CAMERA = "camera"
    LIDAR = "lidar"


class OdometryName(StrEnum):
    """What finds poses."""

    KISS = "kiss"
    NONE = "none"


INSTALLED = "the one that is installed"

_FORMATS = ".bin, .npy, .pcd, .ply, .las, .laz, .feather; a bag of ROS: .bag, .db3, .mcap; or .osf, .pcap."
Input = Annotated[
    Path,
    typer.Argument(
        metavar="INPUT",
        help=f"A KITTI sequence (.../sequences/NN), a root with several, or a folder of scans: {_FORMATS}",
    ),
]
Inputs = Annotated[
    list[str],
    typer.Argument(
        metavar="INPUT...",
        help="Recordings, folders that have some anywhere below, or patterns as 'logs/*/drive.bag'; in files, or at "
        f"s3://BUCKET/KEY. A recording is a KITTI sequence (.../sequences/NN) or a folder of scans: {_FORMATS}",
    ),
]
Bundle = Annotated[Path | None, typer.Option(help="Bundle to use.", show_default=INSTALLED)]
Threads = Annotated[int, typer.Option(min=1, help="Threads to use.")]
SensorName = Annotated[
    str, typer.Option("--sensor", help=f"Sensor of the streets and of the images: {', '.join(SENSORS)}.")
]
StreetSensor = Annotated[
    str,
    typer.Option(
        "--sensor",
        metavar="NAME|FILE.json",
        help=f"Sensor of the streets: {', '.join(SENSORS)}, or a file with the fields of `Sensor`.",
    ),
]
OwnSensor = Annotated[
    str | None,
    typer.Option(
        "--sensor",
        metavar="NAME|FILE.json",
        help=f"Sensor of the scans: {', '.join(SENSORS)}, or a file with the fields of `Sensor`.",
        show_default="the bundle's, or as the first scan shows",
    ),
]
Names = Annotated[
    list[str] | None,
    typer.Option("--sequence", help="Sequence under a root; may be repeated.", show_default="all"),
]
Poses = Annotated[
    Path | None, typer.Option(help="Pose file.", show_default="poses.txt of the sequence, or poses/NN.txt")
]
Calib = Annotated[
    Path | None, typer.Option(help="KITTI calibration with Tr.", show_default="calib.txt of the sequence")
]
Frame = Annotated[
    PoseFrame | None,
    typer.Option(
        "--pose-frame", help="The poses are those of KITTI's camera or of the LiDAR itself.", show_default="camera"
    ),
]
Extrinsics = Annotated[
    str | None,
    typer.Option(
        help="Where the LiDAR sits in the frame of the poses: 'x y z qx qy qz qw' or a matrix, or a file of them.",
        show_default="as the recording says",
    ),
]
Topic = Annotated[str | None, typer.Option(help="Topic of the points in a bag.", show_default="the only one")]
PoseTopic = Annotated[
    str | None,
    typer.Option(help="Topic of the poses in a bag.", show_default="the only odometry in the frame of the points"),
]
World = Annotated[
    str | None,
    typer.Option(help="Frame of TF in which the poses are, as map.", show_default="odom, or else the highest"),
]
Odometry = Annotated[
    OdometryName | None,
    typer.Option(
        help="kiss: find the poses by KISS-ICP, whatever is given; none: they must be given.",
        show_default="kiss, where none are given",
    ),
]
NoDeskew = Annotated[
    bool, typer.Option("--no-deskew", help="Leave points with times as they were measured, one after the other.")
]
Columns = Annotated[
    int | None,
    typer.Option(min=3, help="Numbers a point in .bin files.", show_default="4, or 5 if the fifth is a ring"),
]
RemissionScale = Annotated[
    float | None,
    typer.Option(help="Full remission in the files, by which it is divided.", show_default="as the first scans show"),
]


def opened_sensor(sensor: str) -> Sensor:
    """The sensor of `--sensor`."""
    with wrong_usage():
        return open_sensor(sensor)


@contextmanager
def wrong_usage() -> Iterator[None]:
    """Within, a SettingError is one of the options that were given: exit code 2."""
    try:
        yield
    except SettingError as error:
        raise typer.BadParameter(printable(worded(str(error)))) from None

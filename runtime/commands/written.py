"""Options of what is written beside labels."""

from enum import StrEnum
from typing import Annotated

import typer

from runtime.fleet.wanted import Wanted


class Write(StrEnum):
    """What `mos run` writes."""

    LABEL = "label"
    CLOUD = "cloud"
    STILL = "static"
    MAP = "map"
    BAG = "bag"


class CloudFormat(StrEnum):
    """Of clouds."""

    PLY = "ply"
    PCD = "pcd"
    NPY = "npy"


Format = Annotated[
    CloudFormat | None,
    typer.Option("--format", help="Of clouds.", show_default="ply; of clean ones, the recording's own"),
]
Voxel = Annotated[
    float | None,
    typer.Option(
        min=0.01,
        help="m, of the voxels on which scans vote whether it moves there; the map has a point for each.",
        show_default=str(Wanted.voxel),
    ),
]


def wanted_of(write: set[str], form: CloudFormat | None, voxel: float | None, picture: bool = False) -> Wanted:
    """What is wanted, of which nothing would be ignored."""
    if form is not None and not write & {Write.CLOUD, Write.STILL}:
        raise typer.BadParameter("--format is of clouds: add --write cloud or --write static")
    if voxel is not None and not write & {Write.STILL, Write.MAP}:
        raise typer.BadParameter("--voxel is of what stands still: add --write static or --write map")
    return Wanted(
        cloud=Write.CLOUD in write,
        clean=Write.STILL in write,
        map=Write.MAP in write,
        bag=Write.BAG in write,
        picture=picture,
        form=None if form is None else form.value,
        voxel=Wanted.voxel if voxel is None else voxel,
    )

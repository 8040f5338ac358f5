"""What is to be written of each recording."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Wanted:
    """What is to be written beside the labels."""

    cloud: bool = False  # clouds in which each point says whether it moves
    clean: bool = False  # the recording without what moves
    map: bool = False  # a point for each voxel in which something stands still
    bag: bool = False  # a copy of a bag in which each point says whether it moves
    picture: bool = False  # of the map from above, where Pillow is installed
    form: str | None = None  # of clouds; None: PLY, and of clean ones the recording's own
    voxel: float = 0.1  # m

"""What is heard of recordings while they are labelled, from whatever process of whatever machine."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Said:
    """Something that a user should know of a recording."""

    name: str
    text: str
    warning: bool = False


@dataclass(frozen=True)
class Scans:
    """How far a recording is."""

    name: str
    done: int
    total: int | None  # None: that is not known


@dataclass(frozen=True)
class Done:
    """What became of a recording, or of a piece of it."""

    name: str
    error: str = ""  # why it is not labelled; "": it is
    scans: int = 0  # that were labelled
    resumed: int = 0  # that had their labels
    points: int = 0  # of those that were labelled
    moving: int = 0
    warnings: int = 0
    seconds: float = 0.0  # of all pieces together
    host: str = ""


@dataclass(frozen=True)
class Divided:
    """A recording is to be labelled in pieces: what holds for all of them is settled."""

    name: str
    scans: int
    seconds: float = 0.0
    host: str = ""


Event = Said | Scans | Done | Divided
Hear = Callable[[Event], object]

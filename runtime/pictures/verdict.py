"""What a prediction makes of every point, and the colours of that: safe for the colour-blind on a dark ground."""

import numpy as np
from numpy.typing import NDArray

from runtime.classes import MOVING, UNLABELLED

UNSCORED, STILL, FALSE_ALARM, MISSED, FOUND = range(5)  # drawn in this order: what moves lies on top
Kinds = NDArray[np.uint8]

BACKGROUND = (13, 17, 23)
INK, FAINT = (230, 237, 243), (125, 135, 148)  # of text
CAR_PAINT = (46, 204, 128)  # of the car that carries the LiDAR
COLOURS: dict[int, tuple[int, int, int]] = {  # they differ in lightness too: dark, middle, bright
    UNSCORED: (84, 92, 102),
    STILL: (176, 187, 200),
    FALSE_ALARM: (56, 150, 255),
    MISSED: (255, 214, 51),
    FOUND: (255, 64, 48),
}


def verdict(moving: NDArray[np.bool_] | None, classes: NDArray[np.uint8] | None) -> Kinds:
    """Kind of every point, (N,) uint8, from what was predicted and the true classes (0, 1, 2), either of them.

    Without one of them, what moves by the other is FOUND. Points without a true class are UNSCORED.
    """
    if classes is None:
        if moving is None:
            raise ValueError("neither predictions nor labels: there is nothing to show")
        return np.where(moving, FOUND, STILL).astype(np.uint8)
    moves = classes == MOVING
    seen = moves if moving is None else moving
    kinds = np.where(moves, np.where(seen, FOUND, MISSED), np.where(seen, FALSE_ALARM, STILL))
    kinds[classes == UNLABELLED] = UNSCORED
    return kinds.astype(np.uint8)


def legend(predicted: bool, labelled: bool) -> list[tuple[int, str]]:
    """Kind and meaning of every colour that such a picture may hold."""
    if predicted and labelled:
        return [(FOUND, "mover found"), (MISSED, "mover missed"), (FALSE_ALARM, "false alarm"), (STILL, "static")]
    return [(FOUND, "moving"), (STILL, "static")]

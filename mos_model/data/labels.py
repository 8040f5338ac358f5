"""SemanticKITTI labels as classes, with a check that they are such labels."""

import numpy as np
from numpy.typing import NDArray

from runtime.errors import SequenceError
from runtime.recordings.labels import to_classes

UNLABELLED, STATIC, MOVING = 0, 1, 2

# The semantic classes of the benchmark; 9 is what moving-object segmentation writes for static.
KNOWN = (
    *(0, 1, 9, 10, 11, 13, 15, 16, 18, 20, 30, 31, 32, 40, 44, 48, 49, 50, 51, 52),
    *(60, 70, 71, 72, 80, 81, 99, *range(251, 260)),
)
_UNKNOWN = 255

_TABLE = np.full(1 << 16, _UNKNOWN, np.uint8)
_TABLE[list(KNOWN)] = to_classes(np.array(KNOWN, np.uint32))


def label_classes(labels: NDArray[np.uint32], where: str = "labels") -> NDArray[np.uint8]:
    """Class (N,) uint8 (0 unlabelled, 1 static, 2 moving) of SemanticKITTI labels (N,) uint32.

    Raises SequenceError, naming `where`, if a label is outside the map.
    """
    semantic = labels & np.uint32(0xFFFF)
    classes = _TABLE[semantic]
    if (classes == _UNKNOWN).any():
        unknown = np.unique(semantic[classes == _UNKNOWN])
        raise SequenceError(
            f"{where}: label {', '.join(map(str, unknown[:5]))} is not in the SemanticKITTI map "
            "(0, 1 unlabelled; 9 to 99 static; 251 to 259 moving): are these labels of SemanticKITTI?"
        )
    return classes

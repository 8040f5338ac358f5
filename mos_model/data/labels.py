"""SemanticKITTI labels as classes, with a check that they are such labels."""

import numpy as np
from numpy.typing import NDArray

from runtime.classes import LABELS, label_ids, to_classes
from runtime.errors import SequenceError

_UNKNOWN = 255

_TABLE = np.full(1 << 16, _UNKNOWN, np.uint8)
_TABLE[list(LABELS)] = to_classes(np.array(LABELS, np.uint32))


def label_classes(labels: NDArray[np.uint32], where: str = "labels") -> NDArray[np.uint8]:
    """Class (N,) uint8 (0 unlabelled, 1 static, 2 moving) of SemanticKITTI labels (N,) uint32.

    Raises SequenceError, naming `where`, if a label is outside the map.
    """
    semantic = label_ids(labels)
    classes = _TABLE[semantic]
    if (classes == _UNKNOWN).any():
        unknown = np.unique(semantic[classes == _UNKNOWN])
        raise SequenceError(
            f"{where}: label {', '.join(map(str, unknown[:5]))} is not in the SemanticKITTI map "
            "(0, 1 unlabelled; 9 to 99 static; 251 to 259 moving): are these labels of SemanticKITTI?"
        )
    return classes

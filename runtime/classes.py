"""Which class is moving: the classes of the networks, and the labels of SemanticKITTI that stand for them in files.

Source of the labels: its public evaluation (PRBonn/semantic-kitti-api, semantic-kitti-mos.yaml). Of points with the
true label 0 or 1 nothing is scored; 251 to 259 are moving, all other labels static; what a tool left unlabelled counts
as not moving. Kernels may use the integers: Numba freezes them into compiled code, and they are those of a file format.
"""

import numpy as np
import numpy.typing as npt

CLASSES = ("unlabelled", "static", "moving")  # of the networks, in the order of their outputs
UNLABELLED, STATIC, MOVING = 0, 1, 2

NO_LABEL, OUTLIER = 0, 1
STATIC_LABEL, MOVING_LABEL = 9, 251  # of no kind: what moving-object segmentation writes
KINDS = {  # of things that move at times: label of one that stands, of one that moves
    "car": (10, 252),
    "bicyclist": (31, 253),
    "person": (30, 254),
    "motorcyclist": (32, 255),
    "on rails": (16, 256),
    "bus": (13, 257),
    "truck": (18, 258),
    "other vehicle": (20, 259),
}
MOVERS = {MOVING_LABEL: "of no class"} | {moving: name for name, (_, moving) in KINDS.items()}
STATIC_LABELS = (
    *(STATIC_LABEL, *(standing for standing, _ in KINDS.values())),
    *(11, 15, 40, 44, 48, 49, 50, 51, 52, 60, 70, 71, 72, 80, 81, 99),
)
RANGE = f"{min(MOVERS)} to {max(MOVERS)}"  # of the moving ones, in messages
LABELS = (NO_LABEL, OUTLIER, *STATIC_LABELS, *MOVERS)

_CLASS = np.full(1 << 16, STATIC, np.uint8)
_CLASS[[NO_LABEL, OUTLIER]] = UNLABELLED
_CLASS[list(MOVERS)] = MOVING


def label_ids(labels: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint32]:
    """The lower 16 bits of raw labels: what a point is. The upper ones tell objects apart."""
    return labels & np.uint32(0xFFFF)


def to_classes(labels: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint8]:
    """Raw labels to the classes of the networks, uint8; what is no label of SemanticKITTI counts as static."""
    return _CLASS[label_ids(labels)]

"""What the benchmark SemanticKITTI-MOS lays down: its labels and its hidden test sequences.

Source: its public evaluation (PRBonn/semantic-kitti-api, semantic-kitti-mos.yaml). Of points with the true label 0 or 1
nothing is scored; 251 to 259 are moving, all other labels static; what a tool left unlabelled counts as not moving.
"""

import numpy as np
import numpy.typing as npt

MOVERS = {
    251: "of no class",
    252: "car",
    253: "bicyclist",
    254: "person",
    255: "motorcyclist",
    256: "on rails",
    257: "bus",
    258: "truck",
    259: "other vehicle",
}
OUTLIER = 1
STANDING = (9, 10, 11, 13, 15, 16, 18, 20, 30, 31, 32, 40, 44, 48, 49, 50, 51, 52, 60, 70, 71, 72, 80, 81, 99)
LABELS = (0, OUTLIER, *STANDING, *MOVERS)
TEST_SCANS = {  # of the sequences without public labels, as KITTI odometry has them
    "11": 921,
    "12": 1061,
    "13": 3281,
    "14": 631,
    "15": 1901,
    "16": 1731,
    "17": 491,
    "18": 1801,
    "19": 4981,
    "20": 831,
    "21": 2721,
}

_TRUE = np.zeros(1 << 16, np.bool_)
_TRUE[list(LABELS)] = True
_PREDICTED = _TRUE.copy()
_PREDICTED[OUTLIER] = False  # nobody predicts outliers; ones are a mask of moving points that was never translated


def check_truth(labels: npt.NDArray[np.uint32]) -> str | None:
    """What is wrong with true labels, (N,) uint32; None: nothing."""
    return _unknown(labels, _TRUE)


def check_prediction(labels: npt.NDArray[np.uint32]) -> str | None:
    """What is wrong with predicted labels, (N,) uint32; None: nothing."""
    unknown = _unknown(labels, _PREDICTED)
    return f"{unknown}; write 251 for moving and 9 for static points" if unknown else None


def _unknown(labels: npt.NDArray[np.uint32], known: npt.NDArray[np.bool_]) -> str | None:
    semantic = labels & 0xFFFF  # the upper bits tell objects apart
    wrong = ~known[semantic]
    if not wrong.any():
        return None
    values, counts = np.unique(semantic[wrong], return_counts=True)
    most = ", ".join(str(value) for value in values[:3]) + (", ..." if len(values) > 3 else "")
    return f"unknown label{'s' if len(values) > 1 else ''} {most} on {counts.sum()} of {len(labels)} points"

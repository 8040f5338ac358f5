"""What the benchmark SemanticKITTI-MOS lays down: which labels it knows, and its hidden test sequences."""

import numpy as np
import numpy.typing as npt

from runtime.classes import LABELS, MOVING_LABEL, OUTLIER, STATIC_LABEL, label_ids

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
    return f"{unknown}; write {MOVING_LABEL} for moving and {STATIC_LABEL} for static points" if unknown else None


def _unknown(labels: npt.NDArray[np.uint32], known: npt.NDArray[np.bool_]) -> str | None:
    semantic = label_ids(labels)
    wrong = ~known[semantic]
    if not wrong.any():
        return None
    values, counts = np.unique(semantic[wrong], return_counts=True)
    most = ", ".join(str(value) for value in values[:3]) + (", ..." if len(values) > 3 else "")
    return f"unknown label{'s' if len(values) > 1 else ''} {most} on {counts.sum()} of {len(labels)} points"

"""The whole of `mos eval`, from files, against scikit-learn on the same labels."""

import numpy as np
import pytest

from runtime.classes import LABELS, MOVERS, OUTLIER
from runtime.evaluation.layout import pair
from runtime.evaluation.report import score
from tests.support.dataset import write_labels, write_scans

metrics = pytest.importorskip("sklearn.metrics")


@pytest.fixture
def drawn(tmp_path):
    """Random labels of two sequences on disk, and all of them in memory: sequence, distance, truth, prediction."""
    rng = np.random.default_rng(1)
    rows = []
    for name, frames in (("08", 5), ("19", 2)):
        for frame in range(frames):
            count = int(rng.integers(0, 3000))
            truth = rng.choice(LABELS, count).astype(np.uint32)
            predicted = np.where(rng.random(count) < 0.7, truth, rng.choice(LABELS, count)).astype(np.uint32)
            predicted[predicted == OUTLIER] = 0
            points = rng.uniform(-45, 45, (count, 4)).astype(np.float32)
            folder, file = tmp_path / "sequences" / name, f"{frame:06d}"
            write_labels(folder / "labels", {file: truth | rng.integers(0, 99, count, np.uint32) << 16})
            write_labels(folder / "predictions", {file: predicted})
            write_scans(folder / "velodyne", {file: points})
            distance = np.sqrt((points[:, :3].astype(float) ** 2).sum(1))
            rows.append((np.full(count, int(name)), distance, truth, predicted))
    return tmp_path, *(np.concatenate(column) for column in zip(*rows, strict=True))


def measures(truth, predicted):
    known = truth > 1
    true, guess = truth[known] > 250, predicted[known] > 250
    (_, false), (missed, found) = metrics.confusion_matrix(true, guess)
    shares = metrics.jaccard_score(true, guess), metrics.precision_score(true, guess), metrics.recall_score(true, guess)
    return (found, missed, false), pytest.approx(shares)


def told(scores):
    counts = tuple(scores[key] for key in ("found", "missed", "false_alarms"))
    return counts, tuple(scores[key] for key in ("iou", "precision", "recall"))


def test_every_score_equals_scikit_learn(drawn):
    root, sequence, distance, truth, predicted = drawn
    report = score(pair(root, root))
    assert told(report["together"]) == measures(truth, predicted)
    for name in ("08", "19"):
        one = sequence == int(name)
        assert told(report["sequences"][name]) == measures(truth[one], predicted[one])
    assert len(report["by_range"]) == 6
    for i, row in enumerate(report["by_range"].values()):
        one = (distance >= 10 * i) & (distance < (10 * i + 10 if i < 5 else np.inf))
        assert told(row) == measures(truth[one], predicted[one])
    for label, name in MOVERS.items():
        of_class = truth == label
        recall = metrics.recall_score(of_class[of_class], predicted[of_class] > 250)
        assert report["by_class"][name]["recall"] == pytest.approx(recall)

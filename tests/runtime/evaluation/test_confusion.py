"""The confusion matrix against scikit-learn."""

import math

import numpy as np
import pytest

from runtime.evaluation.confusion import Confusion

metrics = pytest.importorskip("sklearn.metrics")


def test_scores_equal_scikit_learn():
    rng = np.random.default_rng(0)
    labels, predicted = rng.integers(0, 3, (2, 5000)).astype(np.uint8)
    confusion = Confusion()
    confusion.add(labels[:3000].reshape(30, 100), predicted[:3000].reshape(30, 100))
    confusion.add(labels[3000:], predicted[3000:])
    assert np.array_equal(confusion.matrix, metrics.confusion_matrix(labels, predicted))
    known = labels > 0
    truth, guess = labels[known] == 2, predicted[known] == 2
    assert confusion.iou == pytest.approx(metrics.jaccard_score(truth, guess))
    assert confusion.precision == pytest.approx(metrics.precision_score(truth, guess))
    assert confusion.recall == pytest.approx(metrics.recall_score(truth, guess))


def test_unlabelled_points_are_left_out():
    confusion = Confusion()
    confusion.add([0, 0, 2], [2, 1, 2])
    assert confusion.iou == 1


def test_nothing_to_score_is_nan():
    confusion = Confusion()
    confusion.add([1, 0], [1, 2])
    assert math.isnan(confusion.iou)
    assert math.isnan(confusion.precision)

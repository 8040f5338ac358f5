"""Moving or not: pixels, points and refined points agree with what NumPy says."""

import numpy as np
import pytest

from runtime.image.decision import pixel_classes, point_results, take_refined


def probabilities(*shape):
    scores = np.random.default_rng(1).uniform(size=(3, *shape)).astype(np.float32)
    return scores / scores.sum(axis=0)


@pytest.mark.parametrize("threshold", [None, 0.2, 0.4])
def test_points_take_the_class_of_their_pixel(threshold):
    given, pixel = probabilities(8, 16), np.random.default_rng(2).integers(-20, 128, 900).astype(np.int32)
    classes = pixel_classes(given, threshold)
    expected = given.argmax(0) == 2 if threshold is None else given[2] > threshold
    assert np.array_equal(classes == 2, expected)
    moving, probability = point_results(given, pixel, threshold)
    there = pixel >= 0
    assert np.array_equal(moving, there & (classes.reshape(-1)[pixel] == 2))
    assert np.array_equal(probability, np.where(there, given[2].reshape(-1)[pixel], 0))
    assert 0 < moving.sum() < there.sum()


def test_of_equal_classes_the_first_wins():
    given = np.full((3, 1, 2), 1 / 3, np.float32)
    given[:, 0, 1] = 0, 0.5, 0.5
    assert not point_results(given, np.array([0, 1], np.int32), None)[0].any()
    assert (pixel_classes(given, None) != 2).all()


@pytest.mark.parametrize("threshold", [None, 0.4])
def test_refined_points_replace_the_others_stay(threshold):
    refined = probabilities(50).T.copy()
    refined[::3] = np.nan
    moving, probability = np.arange(50) % 2 == 0, np.full(50, 0.25, np.float32)
    before, known = moving.copy(), np.arange(50) % 3 > 0
    take_refined(refined, threshold, moving, probability)
    with np.errstate(invalid="ignore"):
        expected = refined.argmax(1) == 2 if threshold is None else refined[:, 2] > threshold
    assert np.array_equal(moving, np.where(known, expected, before))
    assert np.array_equal(probability, np.where(known, refined[:, 2], np.float32(0.25)))

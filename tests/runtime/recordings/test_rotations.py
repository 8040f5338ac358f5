"""Rotations, against SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.recordings.rotations import (
    matrices_of_quaternions,
    matrices_of_turns,
    quaternions_of_matrices,
    turns_of_matrices,
)

RANDOM = Rotation.random(500, rng=0).as_matrix()
AXES = np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(1).normal(size=(20, 3))])
ANGLES = (0.0, 1e-15, 1e-9, 1e-4, 0.3, 2.0, np.pi - 1e-7, np.pi)
TURNS = np.concatenate([angle * AXES / np.linalg.norm(AXES, axis=1, keepdims=True) for angle in ANGLES])


@pytest.mark.parametrize("matrices", [RANDOM, Rotation.from_rotvec(TURNS).as_matrix()], ids=["any", "special"])
def test_of_matrices(matrices):
    want = Rotation.from_matrix(matrices)
    quaternions, turns = quaternions_of_matrices(matrices), turns_of_matrices(matrices)
    assert (quaternions[:, 3] >= 0).all()
    assert np.abs((quaternions * want.as_quat()).sum(1)).min() > 1 - 1e-14
    assert np.linalg.norm(turns, axis=1).max() <= np.pi + 1e-12
    np.testing.assert_allclose(matrices_of_turns(turns), matrices, atol=1e-14)
    np.testing.assert_allclose(matrices_of_quaternions(quaternions), matrices, atol=1e-14)


def test_of_turns():
    np.testing.assert_allclose(matrices_of_turns(TURNS), Rotation.from_rotvec(TURNS).as_matrix(), atol=1e-14)
    short = TURNS[np.linalg.norm(TURNS, axis=1) < 3]
    np.testing.assert_allclose(turns_of_matrices(matrices_of_turns(short)), short, atol=1e-12)


def test_one_is_as_many():
    assert matrices_of_turns(TURNS[7]).shape == (3, 3)
    np.testing.assert_array_equal(turns_of_matrices(RANDOM[3]), turns_of_matrices(RANDOM)[3])


def test_quaternions_of_any_length_but_none():
    given = np.random.default_rng(2).normal(size=(5, 4))
    np.testing.assert_allclose(matrices_of_quaternions(3 * given), Rotation.from_quat(given).as_matrix(), atol=1e-14)
    for length in (1e-320, 1e-200, 1e200, 1e307):  # whose squares vanish, or are infinite
        got = matrices_of_quaternions(length * given[1:])
        np.testing.assert_allclose(got, matrices_of_quaternions(given[1:]), atol=1e-2 if length < 1e-310 else 1e-14)
    for none in (np.zeros(4), np.full(4, np.nan), np.array([np.inf, 0, 0, 1])):
        assert np.isnan(matrices_of_quaternions(none)).any()

"""The kernels against naive references."""

import numpy as np
import pytest

from runtime.doctor.landmarks import FEWEST, LOOKED_AT, MOST, View, upright_points
from runtime.sensors.range_image import RangeImage
from tests.support import reference_landmarks, street

IMAGE = RangeImage(height=32, width=512, fov_up=3.0, fov_down=-25.0)


@pytest.fixture(scope="module")
def scan():
    return street.scan(street.drive(1)[0], street.boxes())[:, :3].copy()


def random_view(rng) -> View:
    nearest = rng.uniform(2, 30, (32, 512)).astype(np.float32)
    nearest[rng.random((32, 512)) < 0.3] = 0
    nearest[rng.random((32, 512)) < 0.3] = np.inf
    return View(nearest, IMAGE)


def test_upright_points_are_those_of_the_reference(scan):
    few = scan[:: len(scan) // 2000]
    few.setflags(write=False)
    want = reference_landmarks.upright(few)
    np.testing.assert_array_equal(upright_points(few), want[:: -(-len(want) // MOST)])
    assert 0 < len(want) < len(few) / 2


def test_upright_points_lie_on_walls_not_on_the_ground(scan):
    found = upright_points(scan)
    assert FEWEST < len(found) <= MOST
    assert (found[:, 2] > -1.8 + 0.25).all()


@pytest.mark.parametrize("points", [np.empty((0, 3)), [[5, 5, 5]], [[np.nan] * 3], [[1e30, 0, 0]], [[0, 0, 0]]])
def test_nothing_upright(points):
    assert upright_points(np.array(points, np.float32)).shape == (0, 3)


@pytest.mark.parametrize("beams", [64, 40, 128])
def test_no_few_beams_are_met_alone(beams):
    """Column after column, as many sensors give their points."""
    height = np.tile(np.linspace(-1.5, 3, beams), 400_000 // beams)
    angle = np.repeat(np.linspace(-3, 3, 400_000 // beams), beams)
    wall = np.stack([8 * np.cos(angle), 8 * np.sin(angle), height], 1).astype(np.float32)
    assert len(wall) > 8 * LOOKED_AT
    assert len(np.unique(upright_points(wall)[:, 2])) > beams / 3


def test_misfit_is_that_of_the_reference():
    rng = np.random.default_rng(0)
    view = random_view(rng)
    landmarks = (rng.normal(size=(300, 3)) * (12, 12, 2)).astype(np.float32)
    for turn in (0.0, 3.1, -2.0):
        motion = np.eye(4)
        motion[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        motion[:3, 3] = 0.3, -0.2, 0.1
        want = reference_landmarks.misfit(landmarks, motion, view.nearest, IMAGE.fov_down, IMAGE.fov_up)
        assert view.misfit(landmarks, motion) == pytest.approx(want, abs=1e-2)


def test_misfit_of_what_falls_on_nothing_is_unknown():
    rng = np.random.default_rng(1)
    landmarks = rng.uniform(-9, 9, (200, 3)).astype(np.float32)
    empty = View(np.zeros((32, 512), np.float32), IMAGE)
    assert np.isnan(empty.misfit(landmarks, np.eye(4)))
    assert np.isnan(random_view(rng).misfit(landmarks[: FEWEST - 1], np.eye(4)))
    assert np.isnan(random_view(rng).misfit(np.full((200, 3), np.nan, np.float32), np.eye(4)))

"""The bird's-eye view against the naive reference, and what is odd about scans."""

import numpy as np
import pytest

from runtime.bundle.residual import Residual
from runtime.bundle.view import BirdView, View
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.image.making import make_inputs
from tests.support.reference_bird import cell_of, input_image
from tests.support.views import IMAGE, build, check_range_image

BIRD = BirdView(cells=64, cell_size=0.5, bottom=-2.0, top=2.0)


def made(lags=(1,), threads=1, bird=BIRD):
    return make_inputs(View(IMAGE, Residual(lags), bird), Workers(threads))


def scan(seed, count=4000):
    """Points (count, 4), some out of the view on every side, many in one cell."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-20, -20, -3, -0.2), (20, 20, 3, 1.2), (count, 4)).astype(np.float32)
    points[:200, :2] = 3.1
    return points


def moved(seed):
    rng = np.random.default_rng(seed)
    a, pose = rng.uniform(-0.3, 0.3), np.eye(4)
    pose[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    pose[:3, 3] = rng.uniform(-1, 1, 3)
    return pose


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("lags", [(1,), (1, 3)])
def test_input_equals_reference(lags, threads):
    points, past = scan(0), [(scan(i), moved(i)) for i in (1, 2, 3)]
    got = build(made(lags, threads), points, past)
    want = input_image(points, *zip(*past, strict=True), BIRD, lags, IMAGE.mean[4], IMAGE.std[4])
    assert got.image.shape == want.shape == View(IMAGE, Residual(lags), BIRD).shape
    differs = (np.abs(got.image - want) > 1e-4).any(axis=0)
    assert differs.sum() <= 4  # points on the border of a cell, in float32
    assert (got.image[5:] != 0).any(axis=(1, 2)).all()


def test_every_point_keeps_its_cell():
    points = scan(5)
    got = build(made(), points)
    want = [cell_of(point, BIRD) for point in points]
    pixel = np.array([-1 if cell is None else cell[0] * BIRD.cells + cell[1] for cell in want])
    assert (got.pixel != pixel).sum() <= 1
    seen = got.pixel >= 0
    assert 0 < seen.sum() < len(points)
    np.testing.assert_allclose(got.distance[seen], BIRD.top - points[seen, 2], rtol=1e-6)
    assert not got.distance[~seen].any()
    nearest = got.nearest.reshape(-1)
    assert (nearest[got.pixel[seen]] <= got.distance[seen]).all()
    filled = got.first[got.first >= 0]
    assert (nearest[got.pixel[filled]] == got.distance[filled]).all()
    assert (got.nearest[got.first < 0] == 0).all()


def test_the_same_bits_with_any_number_of_threads():
    points, past = scan(0), [(scan(i), moved(i)) for i in (1, 2, 3)]
    one, three = (build(made((1, 2, 3), threads), points, past) for threads in (1, 3))
    for name in ("image", "nearest", "first", "pixel", "distance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


@pytest.mark.parametrize(
    ("point", "row", "column"),
    [((0.1, 0.1, 0), 31, 31), ((15.9, 0.1, 0), 0, 31), ((0.1, 15.9, 0), 31, 0), ((-15.9, -15.9, -2.0), 63, 63)],
)
def test_ahead_is_up_and_left_is_left(point, row, column):
    got = build(made(), np.array([[*point, 0.5]], np.float32))
    assert got.pixel.tolist() == [row * BIRD.cells + column]


def test_what_is_out_of_the_view_has_no_pixel():
    outside = [[17, 0, 0, 0], [0, -17, 0, 0], [1, 1, 2.0, 0], [1, 1, -2.1, 0], [np.nan, 1, 1, 0], [1e38, 1, 0, 0]]
    got = build(made(), np.array([*outside, [0, 0, 0, 0], [1, 1, 1.9, 0]], np.float32))
    assert (got.pixel >= 0).tolist() == [False] * 7 + [True]
    assert np.isfinite(got.image).all()
    assert (got.nearest > 0).sum() == 1


def test_few_points():
    inputs = made()
    build(inputs, scan(0), [(scan(1), moved(1))])  # nothing of it stays in the buffers
    nothing = np.empty((0, 4), np.float32)
    empty = build(inputs, nothing, [(nothing[:, :3], np.eye(4))])
    assert not empty.image.any()
    assert empty.pixel.shape == (0,)
    one = build(inputs, np.array([[5, 0.1, 0.5, np.nan]], np.float32))
    assert (one.image != 0).sum() == 4  # missing remission is the mean, which is 0
    many = np.tile(np.array([[5.1, 0.1, 0.5, 0.9]], np.float32), (1000, 1))
    many[700, 2] = 1.5
    crowded = build(inputs, many)
    (cell,) = np.flatnonzero(crowded.first >= 0)
    assert crowded.first.flat[cell] == 700
    np.testing.assert_allclose(crowded.image.reshape(9, -1)[:4, cell], [1.5, 0.5, 1, 1])


def test_no_past_is_zero_and_scans_are_not_written():
    inputs, points = made((1, 2)), scan(0)
    points.setflags(write=False)
    assert build(inputs, points, [(points[:, :3], np.eye(4))] * 2).image[5:].any(axis=(1, 2)).all()
    got = build(inputs, points, [(points[:, :3], np.eye(4)), None])
    np.testing.assert_array_equal(got.image[5:9], got.image[:4])
    assert not got.image[9:].any()


def test_the_range_image_is_that_of_the_sensor():
    check_range_image(made(), scan(3))


@pytest.mark.parametrize(
    "wrong",
    [
        {"cells": 40},
        {"cells": 0},
        {"cells": 4096},
        {"cell_size": 0.0},
        {"bottom": 3.0},
        {"top": np.inf},
        {"top": np.nan},
    ],
)
def test_a_view_that_cannot_be_is_refused(wrong):
    with pytest.raises(SettingError, match="bird's-eye view"):
        BirdView(**wrong)

"""Points in a cylinder against the naive reference, and what is odd about scans."""

import numpy as np
import pytest

from runtime.bundle.residual import Residual
from runtime.bundle.view import BirdView, CylinderView, View
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.image.making import make_inputs
from tests.support.reference_cylinder import channels_of, place_of
from tests.support.views import IMAGE, build, check_range_image

VIEW = CylinderView(rings=20, sectors=36, layers=8, radius=15.0, bottom=-2.0, top=2.0)


def made(lags=(1,), threads=1):
    return make_inputs(View(IMAGE, Residual(lags), cylinder=VIEW), Workers(threads))


def scan(seed, count=3000):
    """Points (count, 4), some out of the cylinder on every side."""
    rng = np.random.default_rng(seed)
    return rng.uniform((-15, -15, -3, -0.2), (15, 15, 3, 1.2), (count, 4)).astype(np.float32)


def moved(angle, *shift):
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = shift
    return pose


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("lags", [(1,), (1, 3)])
def test_input_equals_reference(lags, threads):
    points, past = scan(0), [(scan(i), moved(0.1 * i, i, -0.5, 0.2)) for i in (1, 2, 3)]
    got = build(made(lags, threads), points, past)
    mean, std = IMAGE.mean[4], IMAGE.std[4]
    want = [channels_of(point, (min(max(float(point[3]), 0), 1) - mean) / std, 0, VIEW) for point in points]
    for lag in lags:
        before, pose = past[lag - 1]
        for point in before[:, :3].astype(float) @ pose[:3, :3].T + pose[:3, 3]:
            want.append(channels_of(point, 0, lag, VIEW))
    assert got.image.shape == (11, 1, len(want))
    differs = (np.abs(got.image[:, 0].T - want) > 1e-4).any(axis=1)
    assert differs.sum() <= 4  # points on the border of a cell, in float32
    seen = got.pixel >= 0
    assert 0 < seen.sum() < len(points)
    assert (got.pixel[seen] == np.flatnonzero(seen)).all()
    np.testing.assert_array_equal(got.first[0, : len(points)], got.pixel)
    assert (got.first[0, len(points) :] == -1).all()
    np.testing.assert_allclose(got.distance[seen], np.linalg.norm(points[seen, :3], axis=1), rtol=1e-6)


def test_the_same_bits_with_any_number_of_threads():
    points, past = scan(0, 40_000), [(scan(i, 40_000), moved(0.1 * i, i, 0, 0)) for i in (1, 2)]
    one, three = (build(made((1, 2), threads), points, past) for threads in (1, 3))
    for name in ("image", "nearest", "first", "pixel", "distance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


def test_the_seam_and_the_border():
    behind = [[-5, 0.0, 0, 0], [-5, -0.0, 0, 0], [-5, 1e-30, 0, 0]]
    outside = [[16, 0, 0, 0], [1, 1, 2.0, 0], [1, 1, -2.1, 0], [np.nan, 1, 1, 0], [1e38, 1, 0, 0], [0, 0, 0, 0]]
    got = build(made(), np.array([*behind, *outside, [0, 0, 1, 0]], np.float32))
    assert (got.pixel >= 0).tolist() == [True] * 3 + [False] * 6 + [True]
    assert got.image[10, 0].max() < np.prod(VIEW.cells)
    assert place_of((-5, 0.0, 0), VIEW)[1] == VIEW.sectors - 1
    assert np.isfinite(got.image).all()
    assert (got.image[10, 0, 3:9] == -1).all()
    assert not got.image[:10, 0, 3:9].any()


def test_few_points_and_no_past():
    inputs = made((1, 2))
    build(inputs, scan(0), [(scan(1), np.eye(4))] * 2)  # nothing of it stays in the buffers
    assert build(inputs, np.empty((0, 4), np.float32)).image.shape == (11, 1, 0)
    one = build(inputs, np.array([[5, 0.1, 0.5, np.nan]], np.float32), [None, None])
    assert one.image.shape == (11, 1, 1)
    assert one.image[8].item() == 0  # missing remission is the mean
    past = build(inputs, np.empty((0, 4), np.float32), [(scan(1), np.eye(4)), None])
    assert past.image.shape == (11, 1, 3000)


def test_scans_are_not_written_and_the_range_image_is_that_of_the_sensor():
    check_range_image(made(), scan(3))


@pytest.mark.parametrize(
    "wrong",
    [{"rings": 0}, {"layers": 1 << 20}, {"radius": 0.0}, {"radius": np.nan}, {"bottom": 3.0}, {"top": np.inf}],
)
def test_a_cylinder_that_cannot_be_is_refused(wrong):
    with pytest.raises(SettingError, match="cylinder"):
        CylinderView(**wrong)


def test_two_views_at_once_are_refused():
    with pytest.raises(SettingError, match="not at both"):
        View(IMAGE, Residual((1,)), BirdView(), VIEW)

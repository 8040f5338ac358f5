import numpy as np
import pytest

from runtime.compute.workers import Workers
from runtime.image.vote import knn_vote
from tests.support import reference_knn


def scene(seed, count=3000, height=16, width=48, moving=0.4, spread=1.5, near=6.0):
    """Pixels with random ranges and labels, a fifth of them empty; pixels of points, and ranges near theirs."""
    rng = np.random.default_rng(seed)
    range_image = (near + spread * rng.standard_normal((height, width))).clip(0.1).astype(np.float32)
    range_image[rng.random((height, width)) < 0.2] = 0
    labels = rng.choice(3, (height, width), p=[0.1, 0.9 - moving, moving]).astype(np.uint8)
    u = rng.integers(0, width, count).astype(np.int32)
    v = rng.integers(0, height, count).astype(np.int32)
    ranges = (range_image[v, u] + 0.3 * rng.random(count)).astype(np.float32)
    return labels, range_image, v * np.int32(width) + u, ranges


def reference(labels, range_image, pixel, ranges):
    v, u = np.divmod(pixel, labels.shape[1])
    return reference_knn.knn_vote(labels, range_image, u, v, ranges)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("seed", "near"), [(0, 6.0), (1, 1.0), (2, 30.0)])  # 1 m: the border's range 0 takes part
def test_vote_equals_the_naive_reference(seed, near, threads):
    arrays = scene(seed, near=near)
    got = knn_vote(*arrays, Workers(threads))
    want = reference(*arrays)
    assert 0.05 < (want == 2).mean() < 0.95
    np.testing.assert_array_equal(got, want)


def test_whole_millimetres_tie_like_the_reference():
    labels, range_image, pixel, ranges = scene(3, spread=0.5)
    range_image, ranges = np.round(range_image, 1), np.round(ranges, 1)
    got = knn_vote(labels, range_image, pixel, ranges, Workers(1))
    np.testing.assert_array_equal(got, reference(labels, range_image, pixel, ranges))


def flat(label):
    return np.full((16, 16), label, np.uint8), np.full((16, 16), 10, np.float32)


def one(labels, range_image, pixel=8 * 16 + 8, distance=10.0):
    arrays = np.array([pixel], np.int32), np.array([distance], np.float32)
    return knn_vote(labels, range_image, *arrays, Workers(1))[0]


def test_uniform_neighbourhoods_keep_their_class():
    assert one(*flat(2)) == 2
    assert one(*flat(1)) == 1
    assert one(*flat(0)) == 1  # unlabelled is never an answer


def test_point_without_pixel_is_static():
    assert one(*flat(2), pixel=-1) == 1


def test_point_behind_a_moving_surface_takes_only_its_own_pixel():
    labels, range_image = flat(2)
    labels[8, 8] = 1
    assert one(labels, range_image, distance=20.0) == 1


def test_tie_is_static():
    labels, range_image = flat(0)
    labels[8, 8], labels[8, 9] = 2, 1
    assert one(labels, range_image) == 1


def test_empty_image_and_no_points():
    labels, range_image = flat(2)
    assert one(labels, np.zeros_like(range_image)) == 2  # the centre stands for the point itself
    none = np.empty(0, np.int32)
    out = knn_vote(labels, range_image, none, np.empty(0, np.float32), Workers(2))
    assert out.shape == (0,)
    assert out.dtype == np.uint8


def test_arrays_may_be_read_only_and_strided():
    labels, range_image, pixel, ranges = scene(4)
    arrays = np.asfortranarray(labels), range_image[:, ::-1].copy()[:, ::-1], pixel, ranges
    for array in arrays:
        array.flags.writeable = False
    np.testing.assert_array_equal(
        knn_vote(*arrays, Workers(2)), knn_vote(labels, range_image, pixel, ranges, Workers(1))
    )

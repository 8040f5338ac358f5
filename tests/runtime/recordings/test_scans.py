import numpy as np
import pytest

from runtime.errors import ScanError
from runtime.recordings.scans import as_scan


def points(count=5, channels=4, dtype=np.float32):
    return np.random.default_rng(0).normal(size=(count, channels)).astype(dtype)


def test_a_float32_scan_is_taken_as_it_is():
    scan = points()
    scan.flags.writeable = False
    assert np.shares_memory(as_scan(scan), scan)


@pytest.mark.parametrize(
    "array", [points(dtype=np.float64), points()[::2], np.asfortranarray(points()), points().astype(">f4")]
)
def test_other_layouts_are_copied(array):
    got = as_scan(array)
    assert got.dtype == np.float32
    assert got.dtype.isnative
    assert got.flags.c_contiguous
    np.testing.assert_array_equal(got, array.astype(np.float32))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_missing_remission_stays_missing(dtype):
    array = points(channels=3, dtype=dtype)
    got = as_scan(array)
    np.testing.assert_array_equal(got, array.astype(np.float32))


@pytest.mark.parametrize("count", [0, 1])
def test_empty_scan_and_one_point(count):
    assert as_scan(points(count)).shape == (count, 4)


def test_values_that_are_not_finite_stay():
    got = as_scan([[np.nan, 1, 2, 3], [1e300, np.inf, 0, 0]])
    np.testing.assert_array_equal(got, np.array([[np.nan, 1, 2, 3], [np.inf, np.inf, 0, 0]], np.float32))


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (points(channels=5), r"shape .* not \(5, 5\)"),
        (points(channels=2), "shape"),
        (points()[0], "shape"),
        (points()[None], "shape"),
        (np.float32(1), "shape"),
        (points(dtype=np.int32), "not int32"),
        (points(dtype=np.float16), "not float16"),
        (np.full((3, 4), "a"), "not <U1"),
        (points(dtype=complex), "not complex128"),
        (np.empty((3, 4), object), "not object"),
        ([[1.0, 2, 3, 4], [1.0, 2]], "no array of points"),
    ],
)
def test_other_arrays_are_refused(array, message):
    with pytest.raises(ScanError, match=message) as error:
        as_scan(array, where="scan 7")
    assert str(error.value).startswith("scan 7:")
    assert isinstance(error.value, ValueError)

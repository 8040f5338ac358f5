import warnings

import numpy as np
import pytest

from runtime.errors import MosWarning, PoseError
from runtime.recordings.calib import read_calib
from tests.runtime.recordings.test_poses import pose

TR = pose(1.5)
RECT = pose(0.01, (1, 2, 0), (0, 0, 0))


def text(matrix, rows=slice(3), columns=slice(4)):
    return " ".join(f"{value:.12e}" for value in matrix[rows, columns].ravel())


TR_TEXT, RECT_TEXT = text(TR), text(RECT, columns=slice(3))


def read(tmp_path, content, encoding="utf-8"):
    (tmp_path / "calib.txt").write_text(content, encoding=encoding)
    return read_calib(tmp_path / "calib.txt")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("key", ["Tr:", "Tr", "Tr :"])
def test_calib_gives_tr(tmp_path, key, encoding):
    got = read(tmp_path, f"{key} {TR_TEXT}\r\nP0: {' '.join(['1'] * 12)}\n", encoding)
    np.testing.assert_allclose(got, TR, atol=1e-11)


def test_tr_has_the_rectification_in_it(tmp_path):
    np.testing.assert_allclose(read(tmp_path, f"R0_rect: {RECT_TEXT}\nTr: {TR_TEXT}\n"), TR, atol=1e-11)


@pytest.mark.parametrize("rect", ["R0_rect:", "R_rect", "R_rect_00:"])
@pytest.mark.parametrize("tr", ["Tr_velo_to_cam:", "Tr_velo_cam", "Tr_velo_to_cam"])
def test_object_and_tracking_files_keep_the_rectification_apart(tmp_path, tr, rect):
    content = f"P2: {' '.join(['1'] * 12)}\n{rect} {RECT_TEXT}\n{tr} {TR_TEXT}\nTr_imu_velo {TR_TEXT}\n"
    np.testing.assert_allclose(read(tmp_path, content), RECT @ TR, atol=1e-11)


def test_raw_data(tmp_path):
    content = "calib_time: 15-Mar-2012 11:37:16\nR: " + text(TR, columns=slice(3))
    content += "\nT: " + " ".join(f"{value:.12e}" for value in TR[:3, 3]) + f"\nR_rect_00: {RECT_TEXT}\n"
    np.testing.assert_allclose(read(tmp_path, content), RECT @ TR, atol=1e-11)


def test_a_missing_rectification_is_said(tmp_path):
    with pytest.warns(MosWarning, match=r"Tr_velo_to_cam without R0_rect.*costs accuracy"):
        got = read(tmp_path, f"Tr_velo_to_cam: {TR_TEXT}\n")
    np.testing.assert_allclose(got, TR, atol=1e-11)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(tmp_path, f"Tr: {TR_TEXT}\n")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("P0: 1 2 3\n", "no line 'Tr:'"),
        ("", "no line 'Tr:'"),
        ("Tr: 1 2 3\n", "3 numbers, not 12"),
        ("Tr: a b c\n", "not made of numbers"),
        ("Tr: " + "2 " * 12 + "\n", "not a rigid transform"),
        (f"Tr_velo_to_cam: {TR_TEXT}\nR0_rect: 1 0 0\n", "R0_rect has 3 numbers, not 9"),
        (f"Tr_velo_to_cam: {TR_TEXT}\nR0_rect: 2 0 0 0 1 0 0 0 1\n", "R0_rect: is not a rigid"),
    ],
)
def test_broken_calib(tmp_path, content, message):
    with pytest.raises(PoseError, match=message) as error:
        read(tmp_path, content)
    assert "calib.txt" in str(error.value)

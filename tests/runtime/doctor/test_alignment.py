"""Of two motions, the one under which standing things stand is found."""

import math

import numpy as np
import pytest

from bench.mounting import turned
from runtime.doctor.alignment import SUSPECT, Fit, check_fits, difference, fit, suspicion
from runtime.doctor.landmarks import upright_points
from runtime.doctor.pairs import view_of
from runtime.sensors.range_image import RangeImage
from tests.support import street

IMAGE = RangeImage(height=32, width=512, fov_up=2.4, fov_down=-24.4)


@pytest.fixture(scope="module")
def scene():
    """View of a scan, landmarks of another, and the T_view_landmarks that is true: 1.2 m forward, 3 degrees left."""
    here, there = street.drive(1)[0], street.drive(1)[0]
    there[:2, 3] += 1.2, 0.05
    there = there @ turned(2, 3)
    scans = [street.scan(pose, street.boxes(), 32, 720)[:, :3].copy() for pose in (here, there)]
    return view_of(scans[1], IMAGE), upright_points(scans[0]), np.linalg.inv(there) @ here


def test_the_true_motion_is_left_alone(scene):
    view, landmarks, true = scene
    one = fit(view, landmarks, true, 1)
    assert one.given < SUSPECT[1]
    assert not one.wrong
    assert (one.best, one.off) == (one.given, 0)


@pytest.mark.parametrize("error", ["half", "double", "none", "inverse", "aside", "turned"])
def test_a_wrong_motion_is_told_from_the_true_one(scene, error):
    view, landmarks, true = scene
    given = true.copy()
    if error in ("half", "double"):
        given[:3, 3] *= 0.5 if error == "half" else 2
    elif error == "none":
        given = np.eye(4)
    elif error == "inverse":
        given = np.linalg.inv(true)
    elif error == "aside":
        given[1, 3] += 0.6
    else:
        given = turned(2, 6) @ true
    one = fit(view, landmarks, given, 1)
    assert one.wrong
    assert one.off == pytest.approx(difference(given, true), abs=0.25)
    assert one.should == pytest.approx(np.linalg.norm(true[:3, 3]), abs=0.1)
    assert one.moves == pytest.approx(np.linalg.norm(given[:3, 3]))


def test_too_little_in_sight_says_nothing(scene):
    view, landmarks, true = scene
    one = fit(view, landmarks[:10], true, 1)
    assert math.isnan(one.given)
    assert not one.wrong


def made(lag=1, given=0.5, best=0.1, off=1.0):
    return Fit(lag, given, best, 0.5, 1.0, off)


@pytest.mark.parametrize(
    ("fits", "bad"),
    [
        ([], False),
        ([made()], False),
        ([made(), made()], True),
        ([made(), made(best=0.45)], False),
        ([made(), made(), made(best=0.45)], True),
        ([made(), made(off=0.1)], False),
        ([made(1), made(3), made(8)], False),
        ([made(given=math.nan, best=math.nan), made(), made()], True),
        ([made(1, best=0.4), made(1, best=0.4), made(3), made(3)], True),
    ],
)
def test_two_pairs_of_a_lag_are_needed_and_most_of_them(fits, bad):
    finding = check_fits(fits)
    assert (finding is not None) == bad
    assert finding is None or finding.level == "bad"


def test_a_misfit_that_is_usual_here_is_no_reason_to_search_again():
    assert suspicion([], 1) == SUSPECT[1]
    assert suspicion([made(1, 0.2, 0.19)], 3) == SUSPECT[3]
    assert suspicion([made(1, 0.2, 0.19)], 1) == 0.25
    assert suspicion([made(1, 0.2, 0.05)], 1) == SUSPECT[1]
    assert suspicion([made(1, 0.9, 0.89)], 1) < 0.4


def test_motions_are_compared_at_a_distance():
    assert difference(np.eye(4), turned(2, 1)) == pytest.approx(np.radians(10), rel=1e-3)
    there = np.eye(4)
    there[:3, 3] = 3, 4, 0
    assert difference(there, np.eye(4)) == pytest.approx(5)

"""Units, remission and points that are not usable: the median of the samples decides."""

import numpy as np
import pytest

from runtime.doctor.check_scans import check_scans
from runtime.doctor.sample import Sample
from tests.support import street


@pytest.fixture(scope="module")
def scan():
    rng = np.random.default_rng(0)
    found = street.scan(street.drive(1)[0], street.boxes())
    found[:, 3] = rng.uniform(0, 1, len(found))
    found.setflags(write=False)
    return found


def times(scan, xyz=1.0, remission=1.0):
    return scan * np.array([xyz, xyz, xyz, remission], np.float32)


def said(scans, topic):
    """Levels and texts about a topic."""
    return [(one.level, one.text) for one in check_scans([Sample.of(scan) for scan in scans]) if one.topic == topic]


def level(scans, topic):
    ((level, _),) = said(scans, topic)
    return level


def test_a_healthy_scan(scan):
    assert {one.level for one in check_scans([Sample.of(scan)])} == {"ok"}


@pytest.mark.parametrize(("factor", "word"), [(1000, "millimetres"), (100, "millimetres"), (0.001, "kilometres")])
def test_units(scan, factor, word):
    ((level, text),) = said([times(scan, factor)] * 3, "range")
    assert level == "bad"
    assert word in text


@pytest.mark.parametrize("factor", [100, 255, 65535])
def test_remission_of_another_scale(scan, factor):
    ((level, text),) = said([times(scan, 1, factor)] * 3, "remission")
    assert level == "bad"
    assert "divide by" in text


def test_remission_that_is_missing(scan):
    none = scan.copy()
    none[:, 3] = np.nan
    assert level([none] * 3, "remission") == "bad"
    assert level([scan[:, :3]] * 3, "remission") == "ok"
    half = scan.copy()
    half[::3, 3] = np.inf
    assert level([half] * 3, "remission") == "warn"
    few = scan.copy()
    few[::100, 3] = np.nan
    assert level([few] * 3, "remission") == "ok"


def test_remission_that_is_constant_costs_little(scan):
    assert level([times(scan, 1, 0)] * 3, "remission") == "warn"


def test_columns_that_are_others(scan):
    five = np.insert(scan, 4, np.arange(len(scan)) % 32, axis=1).astype(np.float32).ravel()
    ((level, text),) = said([five[: len(five) // 4 * 4].reshape(-1, 4)] * 3, "remission")
    assert level == "bad"
    assert "4 float32 each" in text


@pytest.mark.parametrize(
    "spoil",
    [
        lambda scan: times(scan, 1000, 255),
        lambda scan: scan[:0],
        lambda scan: np.full_like(scan, np.nan),
        lambda scan: scan[:1],
    ],
)
def test_no_single_scan_decides(scan, spoil):
    good, bad = spoil(scan), times(scan, 1000, 255)
    assert {one.level for one in check_scans([Sample.of(one) for one in (good, scan, scan)])} <= {"ok", "warn"}
    assert said([good, bad, bad], "range")[0][0] == "bad"
    assert said([good, bad, bad], "remission")[0][0] == "bad"


def test_no_single_point_decides(scan):
    spoiled = scan.copy()
    spoiled[0], spoiled[1], spoiled[2, :3], spoiled[3] = (3e5, 0, 0, 0.5), (9, 0, 0, 1e9), np.nan, (4, 0, 0, -1e9)
    findings = check_scans([Sample.of(spoiled)])
    assert {one.level for one in findings if one.topic != "points"} == {"ok"}
    assert ("ok", "under 0.1 % lie beyond 300 m; left out and never moving") in said([spoiled], "points")


def test_nothing_to_see(scan):
    assert ("bad", "no scan holds usable points") in said([scan[:0]] * 3, "points")
    assert ("bad", "no scan holds usable points") in said([np.zeros_like(scan)] * 3, "points")


def test_a_few_points_stand_for_all(scan):
    few = Sample.of(scan, 1024)
    assert len(few.ranges) == 1024
    assert few.points == len(scan)
    assert few.middle == pytest.approx(Sample.of(scan).middle, rel=0.1)
    assert few.ground.height == pytest.approx(1.8, rel=0.02)


def test_a_few_points_meet_every_column_of_what_repeats():
    scan = np.zeros((50_000, 4), np.float32)
    scan[:, 0], scan[:, 3] = 9, np.arange(50_000) % 50
    assert len(np.unique(Sample.of(scan, 1000).remissions)) == 50

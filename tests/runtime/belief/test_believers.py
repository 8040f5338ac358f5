"""Labels of one scan among others, against dictionaries."""

from dataclasses import replace

import numpy as np
import pytest

from runtime.belief.believers import Online, choose_believer
from runtime.bundle.loading import load_bundle
from runtime.bundle.manifest import BeliefNumbers, Decision, SensorEntry
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.head.refiners import PointLabels
from runtime.image.entry import Entry
from runtime.settings import RunnerSettings
from tests.support import reference_belief as reference
from tests.support.paths import BUNDLE
from tests.support.sights import RANGE_IMAGE, unseen

ALONE = BeliefNumbers(voxel_size=0.5, horizon=3, weight=0.4, floor=-2.0, object_probability=1.0, look_back=0)
TOGETHER = replace(ALONE, object_probability=0.5, doubtful=0.7, in_trail=0.0)
FOLLOWED = replace(TOGETHER, sure=0.8, longest_trail=2, in_trail=0.7)
THRESHOLD = 0.4
ENTRY = SensorEntry("tiny", RANGE_IMAGE, decision=Decision(belief_threshold=THRESHOLD))


def drive(count, points=1200, seed=0):
    """Scans that see the same room from several places, with probabilities that go with the place."""
    rng = np.random.default_rng(seed)
    for t in range(count):
        angle = 0.2 * t
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        pose[:3, 3] = 0.7 * t, -0.3 * t, 0.1
        xyz = rng.uniform(-4, 4, (points, 3))
        xyz[::50] = np.nan
        probability = np.where(xyz[:, 0] > 1, rng.uniform(0.3, 1, points), rng.uniform(0, 0.6, points))
        probability[::50] = 0
        yield Entry(0.2, 300.0, Workers(1)).enter(xyz), pose, probability.astype(np.float32)


def labels(probability):
    return PointLabels(probability > 0.5, probability.copy())


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("numbers", [ALONE, TOGETHER, FOLLOWED])
def test_like_the_reference(numbers, threads):
    believer, past, trail = Online(numbers, ENTRY, Workers(threads)), [], {}
    lifted = lowered = 0
    for scan, pose, probability in drive(7):
        got = believer.believe(scan, pose, labels(probability), unseen, follows=bool(past))
        believer.add(got.places)
        cells, evidence = reference.places(scan.points, scan.takes_part, pose, probability, numbers.voxel_size)
        known = reference.recalled(past, numbers.horizon)
        wanted = [
            reference.log_odds(float(p)) + max(numbers.weight * known.get(cell, 0.0), numbers.floor)
            for cell, p in zip(cells, probability, strict=True)
        ]
        if numbers.object_probability < 1:
            least, doubtful, sure = (
                reference.log_odds(p) for p in (numbers.object_probability, numbers.doubtful, numbers.sure)
            )
            trail = reference.trail(cells, wanted, least, trail, sure, numbers.longest_trail) if past else {}
            wanted = reference.agreed(cells, wanted, least, doubtful, trail, numbers.in_trail)
        for i, cell in enumerate(cells):
            if cell is None:
                assert (got.labels.moving[i], got.labels.probability[i]) == (False, 0)
            elif past:
                want = 1 / (1 + np.exp(-wanted[i]))
                assert got.labels.probability[i] == pytest.approx(want, abs=5e-4)
                assert got.labels.moving[i] == (want > THRESHOLD) or abs(want - THRESHOLD) < 5e-4
                lifted += want > probability[i] + 0.1
                lowered += want < probability[i] - 0.1
        past.append(evidence)
    assert lifted > 50
    assert lowered > 50


def test_a_scan_that_follows_none_keeps_its_labels():
    believer = Online(TOGETHER, ENTRY, Workers(1))
    first, second = drive(2)
    believer.add(believer.believe(*first[:2], labels(first[2]), unseen, follows=False).places)
    given = labels(second[2])
    assert believer.believe(*second[:2], given, unseen, follows=False).labels is given


def test_to_believe_changes_nothing_until_it_is_added():
    believer = Online(TOGETHER, ENTRY, Workers(1))
    first, *others = drive(4)
    believer.add(believer.believe(*first[:2], labels(first[2]), unseen, follows=False).places)
    want = believer.believe(*others[2][:2], labels(others[2][2]), unseen, follows=True).labels
    for scan, pose, probability in others:
        got = believer.believe(scan, pose, labels(probability), unseen, follows=True).labels
    np.testing.assert_array_equal(got.probability, want.probability)


def test_given_labels_are_not_written_to():
    believer = Online(TOGETHER, ENTRY, Workers(1))
    for scan, pose, probability in drive(2):
        given = labels(probability)
        believer.add(believer.believe(scan, pose, given, unseen, follows=True).places)
        np.testing.assert_array_equal(given.probability, probability)
        np.testing.assert_array_equal(given.moving, probability > 0.5)


def test_votes_are_not_believed():
    manifest = load_bundle(BUNDLE).manifest
    with pytest.raises(SettingError, match="knn has votes"):
        choose_believer(RunnerSettings(belief="online"), "knn", manifest, manifest.sensor, Workers(1))
    assert choose_believer(RunnerSettings(), "knn", manifest, manifest.sensor, Workers(1)).horizon == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"voxel_size": 0.0},
        {"voxel_size": float("nan")},
        {"horizon": 0},
        {"horizon": 65},
        {"weight": -1.0},
        {"floor": 1.0},
        {"object_probability": 0.0},
        {"object_probability": 1.5},
        {"object_probability": float("nan")},
        {"doubtful": 0.0},
        {"doubtful": 1.0},
        {"sure": 1.0},
        {"longest_trail": -1},
        {"longest_trail": 65},
        {"in_trail": -1.0},
        {"look_back": -1},
        {"look_back": 65},
        {"through": float("nan")},
        {"ended": -11.0},
        {"unseen": 11.0},
    ],
)
def test_numbers_that_cannot_be(wrong):
    with pytest.raises(SettingError):
        BeliefNumbers(**wrong)

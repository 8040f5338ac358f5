"""MosRunner with belief, alone and over a recording, on the tiny bundle with a short horizon."""

import warnings

import numpy as np
import pytest

from runtime.bundle.residual import HISTORY
from runtime.errors import InferenceError, MosWarning, PoseError, SettingError
from runtime.predict import predict
from runtime.recordings.registry import open_recording
from runtime.runner import MosRunner
from tests.runtime.belief.conftest import COUNT, HORIZON, files
from tests.support.paths import BUNDLE


@pytest.fixture(scope="module")
def runner(bundle):
    return MosRunner(bundle, threads=1, postprocess="none", belief="online")


def run(runner, scans):
    runner.reset()
    return [runner(*scan) for scan in scans]


def same(a, b):
    np.testing.assert_array_equal(a.probability, b.probability)
    np.testing.assert_array_equal(a.moving, b.moving)


def differ(a, b):
    return not np.array_equal(a.probability, b.probability)


def test_what_was_found_at_a_place_counts_there(bundle, runner, scans):
    plain = run(MosRunner(bundle, threads=1, postprocess="none", belief="none"), scans)
    believed = run(runner, scans)
    same(plain[0], believed[0])
    assert all(differ(a, b) for a, b in zip(plain[1:], believed[1:], strict=True))
    assert set(believed[1].timing) == set(plain[1].timing)
    assert believed[1].timing["belief"] > 0


def test_threads_change_nothing(bundle, runner, scans):
    one = MosRunner(bundle, threads=1, postprocess="none", belief="online")
    for a, b in zip(run(runner, scans), run(one, scans), strict=True):
        np.testing.assert_allclose(a.probability, b.probability, atol=1e-5)


@pytest.mark.parametrize("postprocess", ["none", "head"])
def test_a_result_depends_on_so_many_scans_and_no_more(bundle, scans, postprocess):
    runner = MosRunner(bundle, threads=1, postprocess=postprocess, belief="online")
    assert runner.history_length == HISTORY + HORIZON
    want = run(runner, scans)[-1]
    for left_out, equal in ((COUNT - 1 - runner.history_length, True), (COUNT - 1 - HORIZON, False)):
        runner.reset()
        for scan in scans[left_out:-1]:
            runner.remember(*scan)
        got = runner(*scans[-1])
        assert differ(got, want) is not equal


def test_a_call_that_raises_leaves_what_is_believed(runner, scans, monkeypatch):
    *before, last = scans[:12]
    want = run(runner, [*before, last])[-1]
    run(runner, before)
    monkeypatch.setattr(runner._stages.inputs, "_mean", np.full(5, -3e38, np.float32))  # which overflows in the network
    with pytest.raises(InferenceError), np.errstate(all="ignore"):
        runner(*last)
    monkeypatch.undo()
    with pytest.raises(PoseError):
        runner(last[0], 2 * np.eye(4))
    away = last[1].copy()
    away[0, 3] += 50
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(MosWarning, match="jumps"):
            runner(last[0], away)
        with pytest.raises(MosWarning, match="jumps"):
            runner.remember(last[0], away)
    same(runner(*last), want)


def test_a_jump_drops_what_is_believed(runner, scans):
    want = run(runner, scans[:2])
    run(runner, scans)
    away = np.eye(4)
    away[0, 3] = 0.5 * 40 * 2  # whole voxels, so that the same points share them
    with pytest.warns(MosWarning, match="dropped"):
        same(runner(scans[0][0], away @ scans[0][1]), want[0])
    got = runner(scans[1][0], away @ scans[1][1])
    np.testing.assert_allclose(got.probability, want[1].probability, atol=1e-3)


def test_map_coordinates(runner, scans):
    far = np.eye(4)
    far[:3, 3] = 5e6, -4e6, 300.0
    want = run(runner, scans)[-1].probability
    got = run(runner, [(scan, far @ pose) for scan, pose in scans])[-1].probability
    assert (np.abs(got - want) > 1e-3).mean() < 0.02


@pytest.mark.parametrize("scan", [np.empty((0, 4), np.float32), np.full((3, 4), np.nan, np.float32)])
def test_nothing_to_see(runner, scans, scan):
    run(runner, scans[:3])
    result = runner(scan, scans[3][1])
    assert result.moving.shape == (len(scan),)
    assert not result.moving.any()
    assert not result.probability.any()
    assert runner(np.array([[5, 0, 0, 0]], np.float32), scans[4][1]).moving.shape == (1,)


def test_belief_that_there_is_not():
    with pytest.raises(SettingError, match="belief must be one of auto, none, online"):
        MosRunner(BUNDLE, belief="always")


@pytest.mark.parametrize("done", [1, 4, HISTORY + HORIZON, COUNT - 1])
def test_an_interrupted_run_goes_on_to_the_same_bytes(made, runner, tmp_path, done):
    def stop(count, total):
        if count == done:
            raise KeyboardInterrupt

    predict(open_recording(made), runner, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        predict(open_recording(made), runner, tmp_path / "parts", on_progress=stop)
    summary = predict(open_recording(made), runner, tmp_path / "parts")
    assert (summary.resumed, summary.scans) == (done, COUNT - done)
    assert files(tmp_path / "parts") == files(tmp_path / "whole")
    assert len(set(files(tmp_path / "whole").values())) > 1


def test_predictions_without_belief_are_not_continued_with_it(made, bundle, runner, tmp_path):
    predict(open_recording(made), MosRunner(bundle, threads=1, postprocess="none", belief="none"), tmp_path)
    with pytest.raises(SettingError, match="belief"):
        predict(open_recording(made), runner, tmp_path)


@pytest.mark.parametrize(
    ("settings", "belief"),
    [
        ({}, "online"),
        ({"postprocess": "knn"}, "none"),
        ({"belief": "none"}, "none"),
        ({"postprocess": "head"}, "online"),
    ],
)
def test_a_bundle_with_numbers_for_it_believes(bundle, settings, belief):
    """Unless points vote: votes are no probabilities."""
    assert MosRunner(bundle, threads=1, **settings).belief == belief


def test_a_bundle_without_numbers_believes_when_asked():
    assert MosRunner(BUNDLE, threads=1).belief == "none"
    assert MosRunner(BUNDLE, threads=1, postprocess="head", belief="online").belief == "online"
    assert MosRunner(BUNDLE, threads=1, postprocess="head", delay=2).belief == "online"

"""Results that wait for later scans, alone and over a recording, on the tiny bundle with a short horizon."""

import shutil
import warnings

import numpy as np
import pytest

from runtime.bundle.residual import HISTORY
from runtime.errors import MosWarning, SettingError
from runtime.predict import predict
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from runtime.runner import MosRunner
from runtime.settings import LONGEST_DELAY
from tests.runtime.belief.conftest import COUNT, PLACES, files
from tests.support.paths import BUNDLE

DELAY = 2


@pytest.fixture(scope="module")
def runner(bundle):
    return MosRunner(bundle, threads=1, postprocess="none", delay=DELAY)


def run(runner, scans):
    """What each call returned, and what was left."""
    runner.reset()
    return [runner(*scan) for scan in scans], runner.flush()


def same(a, b):
    assert a.index == b.index
    np.testing.assert_array_equal(a.probability, b.probability)
    np.testing.assert_array_equal(a.moving, b.moving)


def test_a_call_returns_the_result_of_an_earlier_scan(runner, scans):
    returned, left = run(runner, scans)
    assert returned[:DELAY] == [None] * DELAY
    results = [*returned[DELAY:], *left]
    assert [result.index for result in results] == list(range(COUNT))
    for result, (scan, _) in zip(results, scans, strict=True):
        assert result.moving.shape == result.probability.shape == (len(scan),)
    assert [result.ready for result in results] == [False] * HISTORY + [True] * (COUNT - HISTORY)
    assert runner.flush() == []


def test_later_scans_count_and_those_after_them_do_not(runner, scans):
    results = run(runner, scans)[0][DELAY:]
    for end in (7, 8, 9, 10):  # what is known when a recording ends there
        returned, left = run(runner, scans[:end])
        assert [result.index for result in left] == [end - 2, end - 1]
        for result in returned[DELAY:]:
            same(result, results[result.index])
        for result in left:
            assert not np.array_equal(result.probability, results[result.index].probability)


def test_without_a_delay_the_result_is_that_of_the_scan(bundle, scans):
    runner = MosRunner(bundle, threads=1, postprocess="none", belief="none")
    returned, left = run(runner, scans[:4])
    assert [result.index for result in returned] == [0, 1, 2, 3]
    assert left == []


@pytest.mark.parametrize("kind", ["place", "time"])
def test_a_jump_loses_no_result_and_makes_it_final(runner, scans, kind):
    returned, left = run(runner, scans[:9])
    want = [*returned[DELAY:], *left]
    runner.reset()
    found = [runner(scan, pose, 0.1 * i) for i, (scan, pose) in enumerate(scans[:9])]
    away = np.eye(4)
    away[0, 3] = 80 if kind == "place" else 0
    later = 0.0 if kind == "place" else 60.0
    with pytest.warns(MosWarning, match="dropped"):
        found.append(runner(scans[9][0], away @ scans[9][1], 0.9 + later))
    for i, (scan, pose) in enumerate(scans[10:13]):
        found.append(runner(scan, away @ pose, 1.0 + later + 0.1 * i))
    results = [*found[DELAY:], *runner.flush()]
    assert [result.index for result in results] == list(range(13))
    for result, expected in zip(results, want, strict=False):
        same(result, expected)


def test_a_call_that_raises_loses_no_result(runner, scans):
    want = run(runner, scans[:8])
    runner.reset()
    found = []
    for i, (scan, pose) in enumerate(scans[:8]):
        if i in (1, 5):
            away = pose.copy()
            away[0, 3] += 50
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                with pytest.raises(MosWarning, match="jumps"):
                    runner(scan, away)
        found.append(runner(scan, pose))
    for a, b in zip([*found[DELAY:], *runner.flush()], [*want[0][DELAY:], *want[1]], strict=True):
        same(a, b)


def test_a_scan_that_is_remembered_has_no_result_and_counts(runner, scans):
    want = run(runner, scans)[0]
    runner.reset()
    start = COUNT - DELAY - 1 - runner.history_length
    assert start >= 0
    for scan in scans[start : COUNT - DELAY - 1]:
        runner.remember(*scan)
    *none, got = [runner(*scan) for scan in scans[COUNT - DELAY - 1 :]]
    assert none == [None] * DELAY
    assert got.index == runner.history_length
    np.testing.assert_array_equal(got.probability, want[-1].probability)


def test_reset_drops_what_waits(runner, scans):
    want = run(runner, scans[:5])
    run(runner, [])
    for scan in scans[5:8]:
        runner(*scan)
    got = run(runner, scans[:5])
    for a, b in zip([*got[0][DELAY:], *got[1]], [*want[0][DELAY:], *want[1]], strict=True):
        same(a, b)


@pytest.mark.parametrize("delay", [-1, 1.5, True, LONGEST_DELAY + 1])
def test_delays_that_cannot_be(delay):
    with pytest.raises(SettingError, match="delay"):
        MosRunner(BUNDLE, delay=delay)


def test_a_delay_needs_belief():
    with pytest.raises(SettingError, match="gains nothing"):
        MosRunner(BUNDLE, delay=3, belief="none")


def test_every_label_lies_under_the_name_of_its_scan(made, scans, runner, tmp_path):
    returned, left = run(runner, scans)
    predict(open_recording(made), runner, tmp_path)
    labels = files(tmp_path)
    assert list(labels) == [f"{i:06d}.label" for i in range(COUNT)]
    for result in [*returned[DELAY:], *left]:
        want = np.where(result.moving, 251, 9).astype("<u4").tobytes()
        assert labels[f"{result.index:06d}.label"] == want


@pytest.mark.parametrize("done", [1, DELAY + 1, 9, COUNT - 1])
def test_an_interrupted_run_goes_on_to_the_same_bytes(made, runner, tmp_path, done):
    def stop(count, total):
        if count == done:
            raise KeyboardInterrupt

    predict(open_recording(made), runner, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        predict(open_recording(made), runner, tmp_path / "parts", on_progress=stop)
    before = len(files(tmp_path / "parts"))
    assert before == max(0, done - DELAY)
    summary = predict(open_recording(made), runner, tmp_path / "parts")
    assert (summary.resumed, summary.scans) == (before, COUNT - before)
    assert files(tmp_path / "parts") == files(tmp_path / "whole")
    assert predict(open_recording(made), runner, tmp_path / "parts").resumed == COUNT


def test_the_first_scans_and_then_the_rest(made, runner, tmp_path):
    """The last of the first scans are labelled anew: now there are later ones."""
    predict(open_recording(made), runner, tmp_path / "whole")
    predict(open_recording(made, Options(limit=7)), runner, tmp_path / "parts")
    summary = predict(open_recording(made), runner, tmp_path / "parts")
    assert (summary.resumed, summary.anew) == (7 - DELAY, DELAY)
    assert files(tmp_path / "parts") == files(tmp_path / "whole")


@pytest.mark.parametrize("lost", [["000004"], ["000003", "000009"], ["000005", "000006"], ["000015"], ["000000"]])
def test_labels_that_are_missing_are_made_again(made, runner, tmp_path, lost):
    predict(open_recording(made), runner, tmp_path)
    whole = files(tmp_path)
    for key in lost:
        next(tmp_path.rglob(f"{key}.label")).unlink()
    summary = predict(open_recording(made), runner, tmp_path)
    assert summary.scans == len(lost)
    assert files(tmp_path) == whole


def test_a_repaired_scan_changes_those_before_it_too(made, runner, tmp_path):
    folder = shutil.copytree(made, tmp_path / "07")
    predict(open_recording(folder), runner, tmp_path / "out")
    scan = folder / "velodyne" / "000006.bin"
    scan.write_bytes(scan.read_bytes()[:-160])
    summary = predict(open_recording(folder), runner, tmp_path / "out")
    assert summary.anew == COUNT - (6 - DELAY)  # the rest of this short recording depends on it
    predict(open_recording(folder), runner, tmp_path / "fresh")
    assert files(tmp_path / "out") == files(tmp_path / "fresh")


@pytest.mark.parametrize("again", [False, True])
def test_a_broken_scan_is_an_end_and_a_beginning(made, runner, tmp_path, again):
    folder = shutil.copytree(made, tmp_path / "07")
    (folder / "velodyne" / "000006.bin").write_bytes(b"123")
    recording = open_recording(folder, Options(skip_broken=True))
    summary = predict(recording, runner, tmp_path / "out", skip_broken=True)
    assert list(summary.broken) == ["000006"]
    if again:
        assert predict(recording, runner, tmp_path / "out", skip_broken=True).resumed == COUNT
    scans = [(scan.data, scan.known_pose()) for scan in open_recording(made)]
    labels = files(tmp_path / "out")
    assert len(labels) == COUNT - 1
    for first, part in ((0, scans[:6]), (7, scans[7:])):
        returned, left = run(runner, part)
        for result in [*returned[DELAY:], *left]:
            want = np.where(result.moving, 251, 9).astype("<u4").tobytes()
            assert labels[f"{first + result.index:06d}.label"] == want


def test_what_is_held_back_is_bounded(runner, scans):
    run(runner, [])
    for i in range(3 * COUNT):
        (runner if i % 2 else runner.remember)(scans[0][0], scans[0][1])
        assert len(runner._delay._line) <= DELAY + 1
    assert runner.history_length - HISTORY == PLACES + DELAY

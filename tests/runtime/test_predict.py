import contextlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from runtime.errors import OutputError, ScanError, SettingError
from runtime.predict import predict, prediction_path
from runtime.recordings.labels import read_labels
from runtime.recordings.sequence import open_sequence
from runtime.runner import MosRunner
from tests.support import street
from tests.support.disk import full_disk
from tests.support.paths import BUNDLE

COUNT = 13  # more than the history holds


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return street.write_kitti(tmp_path_factory.mktemp("street") / "07", COUNT, rows=16, columns=120)


@pytest.fixture(scope="module")
def bundle(made, tmp_path_factory):
    """The tiny bundle with a threshold that its untrained network passes for about half of the points."""
    folder = shutil.copytree(BUNDLE, tmp_path_factory.mktemp("bundle") / "tiny")
    sequence = open_sequence(made)
    runner = MosRunner(folder, threads=1, postprocess="none")
    probabilities = [runner(*sequence.read(i)).probability for i in range(COUNT)]
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["sensors"][0]["decision"]["threshold"] = float(np.median(np.concatenate(probabilities)))
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


class RecordingRunner(MosRunner):
    """Keeps the probabilities of its results: labels of an untrained network hardly show its history."""

    def __init__(self, *arguments, **options):
        self.seen = []
        super().__init__(*arguments, **options)

    def __call__(self, *arguments):
        result = super().__call__(*arguments)
        self.seen.append(result.probability)
        return result

    def reset(self):
        super().reset()
        self.seen = []


@pytest.fixture(scope="module")
def runner(bundle):
    return RecordingRunner(bundle, threads=1, postprocess="none")


@pytest.fixture(scope="module")
def run_whole(made, runner, tmp_path_factory):
    """An uninterrupted run: bytes of every file by name, and the probabilities of every scan."""
    out = tmp_path_factory.mktemp("whole")
    predict(open_sequence(made), runner, out)
    return contents(out), runner.seen


@pytest.fixture(scope="module")
def whole(run_whole):
    return run_whole[0]


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "07")


def contents(out):
    predictions = Path(out) / "sequences" / "07" / "predictions"
    return {file.name: file.read_bytes() for file in sorted(predictions.iterdir())}


def stop_after(scans):
    """Stands for Ctrl-C after so many scans."""

    def on_progress(done, total):
        if done == scans:
            raise KeyboardInterrupt

    return on_progress


def test_every_scan_gets_the_labels_of_the_runner(made, runner, whole, tmp_path):
    sequence = open_sequence(made)
    seen = []
    summary = predict(sequence, runner, tmp_path, on_progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i, COUNT) for i in range(COUNT + 1)]
    assert contents(tmp_path) == whole
    assert list(whole) == [f"{i:06d}.label" for i in range(COUNT)]

    runner.reset()
    moving = 0
    for i in range(COUNT):
        result = runner(*sequence.read(i))
        labels = read_labels(prediction_path(tmp_path, sequence, i), len(sequence.read(i)[0]))
        np.testing.assert_array_equal(labels, np.where(result.moving, 251, 9))
        moving += int(result.moving.sum())
    assert 0.3 < moving / summary.points < 0.7  # swapped or constant labels would show
    assert (summary.scans, summary.resumed, summary.moving) == (COUNT, 0, moving)
    assert summary.points == sum(len(sequence.read(i)[0]) for i in range(COUNT))
    assert {"read", "write", "scan"} < set(summary.latency)
    assert all(len(seconds) == COUNT for seconds in summary.latency.values())


@pytest.mark.parametrize("scans", [1, 4, 10, COUNT])
def test_an_interrupted_run_goes_on_to_the_same_bytes(made, runner, run_whole, tmp_path, scans):
    whole, probabilities = run_whole
    sequence = open_sequence(made)
    with pytest.raises(KeyboardInterrupt):
        predict(sequence, runner, tmp_path, on_progress=stop_after(scans))
    before = contents(tmp_path)
    assert len(before) == scans
    times = [prediction_path(tmp_path, sequence, i).stat().st_mtime_ns for i in range(scans)]
    summary = predict(sequence, runner, tmp_path)
    assert (summary.resumed, summary.scans) == (scans, COUNT - scans)
    assert contents(tmp_path) == whole
    assert [prediction_path(tmp_path, sequence, i).stat().st_mtime_ns for i in range(scans)] == times
    for after, expected in zip(runner.seen, probabilities[scans:], strict=True):
        np.testing.assert_array_equal(after, expected)


def test_results_depend_on_the_history(made, runner, run_whole):
    """Else the test above could not see a history that is not refilled."""
    runner.reset()
    alone = runner(*open_sequence(made).read(10)).probability
    assert (alone != run_whole[1][10]).mean() > 0.1


def test_the_first_scans_and_then_the_rest(made, runner, whole, tmp_path):
    predict(open_sequence(made, limit=5), runner, tmp_path)
    assert predict(open_sequence(made), runner, tmp_path).resumed == 5
    assert contents(tmp_path) == whole


def test_incomplete_predictions_are_made_again(made, runner, whole, tmp_path):
    sequence = open_sequence(made)
    predict(sequence, runner, tmp_path)
    cut = prediction_path(tmp_path, sequence, 6)
    cut.write_bytes(cut.read_bytes()[:-4])
    prediction_path(tmp_path, sequence, 9).unlink()
    assert predict(sequence, runner, tmp_path).resumed == 6
    assert contents(tmp_path) == whole


def test_other_poses_are_refused_and_overwritten_on_request(folder, runner, whole, tmp_path):
    sequence = open_sequence(folder)
    with pytest.raises(KeyboardInterrupt):
        predict(sequence, runner, tmp_path / "out", on_progress=stop_after(3))
    poses = folder / "poses.txt"
    good = poses.read_text()
    street.write_poses(poses, np.tile(np.eye(4), (COUNT, 1, 1)))
    with pytest.raises(SettingError, match=r"poses_sha256.*--overwrite"):
        predict(open_sequence(folder), runner, tmp_path / "out")
    assert len(contents(tmp_path / "out")) == 3
    still = predict(open_sequence(folder), runner, tmp_path / "out", overwrite=True)
    assert (still.resumed, still.scans) == (0, COUNT)
    poses.write_text(good)
    predict(open_sequence(folder), runner, tmp_path / "out", overwrite=True)
    assert contents(tmp_path / "out") == whole


def test_overwriting_is_not_resumed_from_what_was_there_before(folder, runner, tmp_path):
    predict(open_sequence(folder), runner, tmp_path)
    with pytest.raises(KeyboardInterrupt):
        predict(open_sequence(folder), runner, tmp_path, overwrite=True, on_progress=stop_after(2))
    assert predict(open_sequence(folder), runner, tmp_path).resumed == 2


def test_another_postprocessing_is_refused(made, bundle, runner, tmp_path):
    predict(open_sequence(made, limit=2), runner, tmp_path)
    other = MosRunner(bundle, threads=1, postprocess="knn")
    with pytest.raises(SettingError, match="postprocess"):
        predict(open_sequence(made), other, tmp_path)


@pytest.mark.parametrize("key", ["precision", "version", "refine", "manifest_sha256"])
def test_what_labels_depend_on_is_noted(made, runner, tmp_path, key):
    sequence = open_sequence(made, limit=2)
    predict(sequence, runner, tmp_path)
    note = tmp_path / "sequences" / "07" / "run.json"
    note.write_text(json.dumps(json.loads(note.read_text()) | {key: "another"}))
    with pytest.raises(SettingError, match=key):
        predict(sequence, runner, tmp_path)


@pytest.mark.parametrize("text", [None, "{", "[]", json.dumps({"bundle": "other"})])
def test_predictions_of_unknown_origin_are_not_continued(made, runner, tmp_path, text):
    sequence = open_sequence(made, limit=2)
    predict(sequence, runner, tmp_path)
    note = tmp_path / "sequences" / "07" / "run.json"
    note.unlink() if text is None else note.write_text(text)
    with pytest.raises(SettingError, match="--overwrite"):
        predict(sequence, runner, tmp_path)


def test_a_broken_scan_leaves_what_was_finished_and_says_where(folder, runner, whole, tmp_path):
    path = folder / "velodyne" / "000010.bin"
    good = path.read_bytes()
    path.write_bytes(good[:-1])
    with pytest.raises(ScanError, match=r"stopped at scan 000010\.bin \(11 of 13\).*no whole number") as error:
        predict(open_sequence(folder), runner, tmp_path / "out")
    assert "same command" in str(error.value)
    assert contents(tmp_path / "out") == {name: whole[name] for name in list(whole)[:10]}
    path.write_bytes(good)
    assert predict(open_sequence(folder), runner, tmp_path / "out").resumed == 10
    assert contents(tmp_path / "out") == whole


def test_output_that_cannot_be_written(made, runner, tmp_path):
    (tmp_path / "out").write_text("a file, no folder")
    with pytest.raises(OutputError, match="cannot write"):
        predict(open_sequence(made), runner, tmp_path / "out")


def test_a_full_disk_in_the_middle(made, runner, whole, tmp_path):
    sequence = open_sequence(made)

    def fill(done, total):
        if done == 4:
            disk.enter_context(full_disk(100))

    with contextlib.ExitStack() as disk, pytest.raises(OutputError, match=r"stopped at scan 000004\.bin.*too large"):
        predict(sequence, runner, tmp_path, on_progress=fill)
    assert len(contents(tmp_path)) == 4
    predict(sequence, runner, tmp_path)
    assert contents(tmp_path) == whole


def test_points_without_direction_are_static(folder, runner, tmp_path):
    path = folder / "velodyne" / "000009.bin"
    scan = np.fromfile(path, np.float32).reshape(-1, 4)
    scan[::3] = 0
    scan[1::3, 0] = np.nan
    scan.tofile(path)
    sequence = open_sequence(folder)
    predict(sequence, runner, tmp_path)
    labels = read_labels(prediction_path(tmp_path, sequence, 9), len(scan))
    assert (labels[::3] == 9).all()
    assert (labels[1::3] == 9).all()


def test_empty_scans_and_arrays_without_remission(tmp_path, runner):
    folder = tmp_path / "log"
    folder.mkdir()
    for i, pose in enumerate(street.drive(3)):
        scan = street.scan(pose, street.boxes(), rows=8, columns=60)
        np.save(folder / f"{i}.npy", scan[:, :3] if i != 1 else scan[:0])
    street.write_poses(folder / "poses.txt", street.drive(3))
    sequence = open_sequence(folder, frame="lidar")
    summary = predict(sequence, runner, tmp_path / "out")
    assert summary.scans == 3
    sizes = [prediction_path(tmp_path / "out", sequence, i).stat().st_size for i in range(3)]
    assert sizes[1] == 0
    assert min(sizes[0], sizes[2]) > 0

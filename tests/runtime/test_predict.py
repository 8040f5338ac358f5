import contextlib
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from runtime.errors import MosWarning, OutputError, ScanError, SettingError
from runtime.predict import predict, predictions_folder
from runtime.recordings.formats.registry import read_cloud
from runtime.recordings.journal import Journal
from runtime.recordings.labels import read_prediction, write_labels
from runtime.recordings.recording import Options, Recording
from runtime.recordings.registry import open_recording
from runtime.recordings.remission import FIRST
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
    recording = open_recording(made)
    runner = MosRunner(folder, threads=1, postprocess="none")
    probabilities = [label(runner, scan).probability for scan in recording]
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

    def reset(self, keep_sensor=False):
        super().reset()
        self.seen = []


@pytest.fixture(scope="module")
def runner(bundle):
    return RecordingRunner(bundle, threads=1, postprocess="none")


@pytest.fixture(scope="module")
def run_whole(made, runner, tmp_path_factory):
    """An uninterrupted run: bytes of every file by name, and the probabilities of every scan."""
    out = tmp_path_factory.mktemp("whole")
    predict(open_recording(made), runner, out)
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


def label(runner, scan):
    return runner(scan.data, scan.pose, scan.time)


def label_file(out, recording, index):
    return predictions_folder(out, recording.name) / f"{recording.keys[index]}.label"


def stop_after(scans):
    """Stands for Ctrl-C after so many scans."""

    def on_progress(done, total):
        if done == scans:
            raise KeyboardInterrupt

    return on_progress


def test_every_scan_gets_the_labels_of_the_runner(made, runner, whole, tmp_path):
    recording = open_recording(made)
    seen = []
    summary = predict(recording, runner, tmp_path, on_progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i, COUNT) for i in range(COUNT + 1)]
    assert contents(tmp_path) == whole
    assert list(whole) == [f"{i:06d}.label" for i in range(COUNT)]

    runner.reset()
    moving = 0
    for i in range(COUNT):
        result = label(runner, recording.read(i))
        labels = read_prediction(label_file(tmp_path, recording, i), recording.count(i))
        np.testing.assert_array_equal(labels, np.where(result.moving, 251, 9))
        moving += int(result.moving.sum())
    assert 0.3 < moving / summary.points < 0.7  # swapped or constant labels would show
    assert (summary.scans, summary.resumed, summary.moving) == (COUNT, 0, moving)
    assert summary.points == sum(recording.count(i) for i in range(COUNT))
    assert {"read", "write", "scan"} < set(summary.latency)
    assert all(len(seconds) == COUNT for seconds in summary.latency.values())


@pytest.mark.parametrize("scans", [1, 4, 10, COUNT])
def test_an_interrupted_run_goes_on_to_the_same_bytes(made, runner, run_whole, tmp_path, scans):
    whole, probabilities = run_whole
    recording = open_recording(made)
    with pytest.raises(KeyboardInterrupt):
        predict(recording, runner, tmp_path, on_progress=stop_after(scans))
    before = contents(tmp_path)
    assert len(before) == scans
    times = [label_file(tmp_path, recording, i).stat().st_mtime_ns for i in range(scans)]
    summary = predict(recording, runner, tmp_path)
    assert (summary.resumed, summary.scans) == (scans, COUNT - scans)
    assert contents(tmp_path) == whole
    assert [label_file(tmp_path, recording, i).stat().st_mtime_ns for i in range(scans)] == times
    for after, expected in zip(runner.seen, probabilities[scans:], strict=True):
        np.testing.assert_array_equal(after, expected)


def test_results_depend_on_the_history(made, runner, run_whole):
    """Else the test above could not see a history that is not refilled."""
    runner.reset()
    alone = label(runner, open_recording(made).read(10)).probability
    assert (alone != run_whole[1][10]).mean() > 0.1


def test_the_first_scans_and_then_the_rest(made, runner, whole, tmp_path):
    predict(open_recording(made, Options(limit=5)), runner, tmp_path)
    assert predict(open_recording(made), runner, tmp_path).resumed == 5
    assert contents(tmp_path) == whole


def test_incomplete_predictions_are_made_again(made, runner, whole, tmp_path):
    recording = open_recording(made)
    predict(recording, runner, tmp_path)
    cut = label_file(tmp_path, recording, 6)
    cut.write_bytes(cut.read_bytes()[:-4])
    label_file(tmp_path, recording, 9).unlink()
    summary = predict(recording, runner, tmp_path)
    assert (summary.resumed, summary.scans, summary.anew) == (COUNT - 2, 2, 0)
    assert contents(tmp_path) == whole


def test_a_run_without_points_of_the_vehicle_goes_on(made, bundle, tmp_path):
    with MosRunner(bundle, threads=1, postprocess="none", body=(-1, -1, -2, 3, 1, 0)) as runner:
        for resumed in (0, 3):
            assert predict(open_recording(made, Options(limit=3)), runner, tmp_path).resumed == resumed


def test_poses_of_another_file_are_refused_and_overwritten_on_request(folder, runner, whole, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        predict(open_recording(folder), runner, tmp_path / "out", on_progress=stop_after(3))
    other = Options(poses=folder / "other.txt")
    street.write_poses(folder / "other.txt", np.tile(np.eye(4), (COUNT, 1, 1)))
    with pytest.raises(SettingError, match=r"\(poses differ.*`overwrite`"):
        predict(open_recording(folder, other), runner, tmp_path / "out")
    assert len(contents(tmp_path / "out")) == 3
    with pytest.warns(MosWarning, match="surroundings"):
        still = predict(open_recording(folder, other), runner, tmp_path / "out", overwrite=True)
    assert (still.resumed, still.scans) == (0, COUNT)
    predict(open_recording(folder), runner, tmp_path / "out", overwrite=True)
    assert contents(tmp_path / "out") == whole


def change(folder, index, factor=0.5):
    path = folder / "velodyne" / f"{index:06d}.bin"
    scan = np.fromfile(path, np.float32).reshape(-1, 4)
    scan[:, 3] *= factor
    scan.tofile(path)


def times_of(out):
    predictions = Path(out) / "sequences" / "07" / "predictions"
    return {file.name: file.stat().st_mtime_ns for file in predictions.iterdir()}


def test_scans_repaired_in_place_are_labelled_anew(folder, runner, whole, tmp_path):
    """As where remission was 0..255: all labels were wrong, and the same command makes them right."""
    for i in range(COUNT):
        change(folder, i, 256)
    predict(open_recording(folder), runner, tmp_path / "out")
    assert contents(tmp_path / "out") != whole
    for i in range(COUNT):
        change(folder, i, 1 / 256)
    summary = predict(open_recording(folder), runner, tmp_path / "out")
    assert (summary.resumed, summary.scans, summary.anew) == (0, COUNT, COUNT)
    assert contents(tmp_path / "out") == whole
    assert predict(open_recording(folder), runner, tmp_path / "out").resumed == COUNT


@pytest.mark.parametrize("keep_time", [False, True])
def test_a_repaired_scan_and_those_that_depend_on_it_are_labelled_anew(folder, runner, run_whole, tmp_path, keep_time):
    whole, probabilities = run_whole
    path = folder / "velodyne" / "000002.bin"
    stat = path.stat()
    change(folder, 2)
    predict(open_recording(folder), runner, tmp_path / "out")
    changed, before = contents(tmp_path / "out"), times_of(tmp_path / "out")
    change(folder, 2, 2)
    if keep_time:  # size and time of the file do not show it
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    summary = predict(open_recording(folder), runner, tmp_path / "out")
    anew = {name for name, time in times_of(tmp_path / "out").items() if time != before[name]}
    assert anew == {f"{i:06d}.label" for i in range(2, 2 + runner.history_length + 1)}
    assert (summary.resumed, summary.scans, summary.anew) == (COUNT - 9, 9, 9)
    assert contents(tmp_path / "out") == whole != changed
    for after, expected in zip(runner.seen, probabilities[2:11], strict=True):
        np.testing.assert_array_equal(after, expected)


def test_a_repaired_pose_is_noticed(folder, runner, whole, tmp_path):
    poses = folder / "poses.txt"
    good = poses.read_text()
    rows = good.splitlines(keepends=True)
    poses.write_text("".join([*rows[:6], rows[5], *rows[7:]]))
    predict(open_recording(folder), runner, tmp_path / "out")
    poses.write_text(good)
    assert predict(open_recording(folder), runner, tmp_path / "out").anew == COUNT - 6
    assert contents(tmp_path / "out") == whole


def test_a_scan_that_is_missing_now_is_noticed(folder, runner, tmp_path):
    """Those after it have another past."""
    predict(open_recording(folder), runner, tmp_path / "out")
    (folder / "velodyne" / "000003.bin").unlink()
    with pytest.warns(MosWarning, match="13 poses for 12 scans"):
        recording = open_recording(folder)
    summary = predict(recording, runner, tmp_path / "out")
    assert (summary.resumed, summary.anew) == (COUNT - 9, 8)


@pytest.mark.parametrize("moment", range(1, 40, 3))
def test_killed_at_any_moment_while_labels_are_made_anew(folder, runner, whole, tmp_path, monkeypatch, moment):
    """Before, between and after the writes of labels and of what they were made of; then the scan is put back."""
    change(folder, 2)
    predict(open_recording(folder), runner, tmp_path / "out")
    changed = contents(tmp_path / "out")
    change(folder, 2, 2)
    left = moment

    def dying(function):
        def write(*arguments, **options):
            nonlocal left
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
            return function(*arguments, **options)

        return write

    with monkeypatch.context() as patch:
        patch.setattr("runtime.predict.write_labels", dying(write_labels))
        patch.setattr(Journal, "note", dying(Journal.note))
        with contextlib.suppress(KeyboardInterrupt):
            predict(open_recording(folder), runner, tmp_path / "out")
    if moment % 2:
        predict(open_recording(folder), runner, tmp_path / "out")
        assert contents(tmp_path / "out") == whole
    else:
        change(folder, 2)
        predict(open_recording(folder), runner, tmp_path / "out")
        assert contents(tmp_path / "out") == changed


@pytest.mark.parametrize("tail", ['{"scan": "00000', "\n\n[]\n", '{"scan": "000004", "x": 1}\n', "\0\0\0"])
def test_half_a_line_in_the_journal_costs_no_more_than_its_scan(made, runner, whole, tmp_path, tail):
    recording = open_recording(made)
    predict(recording, runner, tmp_path)
    journal = tmp_path / "sequences" / "07" / "scans.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:-1]) + tail)
    assert predict(recording, runner, tmp_path).resumed == COUNT - 1
    assert contents(tmp_path) == whole
    assert predict(recording, runner, tmp_path).resumed == COUNT


def test_another_recording_of_the_same_name_is_refused(made, folder, runner, whole, tmp_path):
    predict(open_recording(made), runner, tmp_path / "out")
    assert predict(open_recording(folder), runner, tmp_path / "out").resumed == COUNT  # it was only moved
    for i in range(COUNT):
        change(folder, i)
    predict(open_recording(made), runner, tmp_path / "out")
    with pytest.raises(SettingError, match=r"another recording, .*07; .*`overwrite`"):
        predict(open_recording(folder), runner, tmp_path / "out")
    assert contents(tmp_path / "out") == whole


class Stream(Recording):
    """Scans that come once, nobody knows how many."""

    name, source, sensor, poses_from = "07", "a stream", None, None

    def __init__(self, recording):
        self._recording = recording

    def scans(self, start=0):
        return self._recording.scans(start)


def test_a_recording_without_an_index(made, runner, whole, tmp_path):
    stream, seen = Stream(open_recording(made)), []
    predict(stream, runner, tmp_path, on_progress=lambda done, total: seen.append((done, total)))
    assert contents(tmp_path) == whole
    assert seen == [(i, None) for i in range(COUNT + 1)]
    assert predict(stream, runner, tmp_path).resumed == COUNT


def test_a_gap_in_time_drops_the_history(folder, runner, tmp_path):
    times = 0.1 * np.arange(COUNT)
    times[7:] += 5
    np.savetxt(folder / "times.txt", times)
    recording = open_recording(folder)
    with pytest.warns(MosWarning, match=r"time steps by 5\.1"):
        predict(recording, runner, tmp_path / "out")
    after = runner.seen[7:]
    runner.reset()
    for scan, expected in zip(recording.scans(7), after, strict=True):
        np.testing.assert_array_equal(label(runner, scan).probability, expected)
    (folder / "times.txt").unlink()
    assert predict(open_recording(folder), runner, tmp_path / "out").anew == COUNT


def test_times_without_a_gap_change_nothing(folder, runner, whole, tmp_path):
    np.savetxt(folder / "times.txt", 0.1 * np.arange(COUNT))
    predict(open_recording(folder), runner, tmp_path / "out")
    assert contents(tmp_path / "out") == whole


def break_scan(folder, index):
    path = folder / "velodyne" / f"{index:06d}.bin"
    good = path.read_bytes()
    path.write_bytes(good[:-1])
    return lambda: path.write_bytes(good)


def note_of(out):
    return json.loads((Path(out) / "sequences" / "07" / "run.json").read_text())


@pytest.mark.parametrize("what", ["scan", "pose"])
def test_broken_scans_are_skipped_on_request(folder, runner, whole, tmp_path, what):
    if what == "scan":
        repair = break_scan(folder, 4)
    else:
        good = (folder / "poses.txt").read_text()
        rows = good.splitlines(keepends=True)
        (folder / "poses.txt").write_text("".join([*rows[:4], "nan" + rows[4][rows[4].index(" ") :], *rows[5:]]))
        repair = lambda: (folder / "poses.txt").write_text(good)  # noqa: E731
    options = Options(skip_broken=True)
    summary = predict(open_recording(folder, options), runner, tmp_path / "out", skip_broken=True)
    assert (summary.scans, summary.resumed, list(summary.broken)) == (COUNT - 1, 0, ["000004"])
    (noted,) = note_of(tmp_path / "out")["broken"]
    assert noted == {"scan": "000004", "reason": summary.broken["000004"]}
    assert ("no whole number" if what == "scan" else "NaN") in noted["reason"]
    found = contents(tmp_path / "out")
    assert found.keys() == whole.keys() - {"000004.label"}
    assert all(found[name] == whole[name] for name in list(whole)[:4])
    rest, recording = runner.seen, open_recording(folder, options)  # those since the history was dropped
    runner.reset()
    for scan, expected in zip(recording.scans(5), rest, strict=True):
        np.testing.assert_array_equal(label(runner, scan).probability, expected)

    again = predict(recording, runner, tmp_path / "out", skip_broken=True)
    assert (again.scans, again.resumed, list(again.broken)) == (0, COUNT, ["000004"])
    repair()
    repaired = predict(open_recording(folder), runner, tmp_path / "out", skip_broken=True)
    assert (repaired.scans, repaired.resumed, repaired.anew) == (9, 4, 8)
    assert note_of(tmp_path / "out")["broken"] == []
    assert contents(tmp_path / "out") == whole


def test_a_scan_that_breaks_later_loses_its_label(folder, runner, whole, tmp_path):
    predict(open_recording(folder), runner, tmp_path / "out")
    repair = break_scan(folder, 0)
    summary = predict(open_recording(folder), runner, tmp_path / "out", skip_broken=True)
    assert "000000.label" not in contents(tmp_path / "out")
    assert summary.scans == 8
    repair()
    predict(open_recording(folder), runner, tmp_path / "out")
    assert contents(tmp_path / "out") == whole


def test_every_scan_is_read_once(made, runner, tmp_path, monkeypatch):
    """But for the first few when it is opened: they show the scale of the remission, and whether points have times."""
    read = []
    monkeypatch.setattr(
        "runtime.recordings.scan_files.read_cloud", lambda path, columns: (read.append(path), read_cloud(path))[1]
    )
    recording = open_recording(made)
    assert sorted(read) == sorted([recording.files[0], *recording.files[:FIRST]])
    for _ in range(2):
        read.clear()
        predict(recording, runner, tmp_path)
        assert sorted(read) == sorted(recording.files)


def test_overwriting_is_not_resumed_from_what_was_there_before(folder, runner, tmp_path):
    predict(open_recording(folder), runner, tmp_path)
    with pytest.raises(KeyboardInterrupt):
        predict(open_recording(folder), runner, tmp_path, overwrite=True, on_progress=stop_after(2))
    assert predict(open_recording(folder), runner, tmp_path).resumed == 2


def test_another_postprocessing_is_refused(made, bundle, runner, tmp_path):
    predict(open_recording(made, Options(limit=2)), runner, tmp_path)
    other = MosRunner(bundle, threads=1, postprocess="knn")
    with pytest.raises(SettingError, match="postprocess"):
        predict(open_recording(made), other, tmp_path)


@pytest.mark.parametrize("key", ["precision", "version", "refine", "manifest_sha256"])
def test_what_labels_depend_on_is_noted(made, runner, tmp_path, key):
    recording = open_recording(made, Options(limit=2))
    predict(recording, runner, tmp_path)
    note = tmp_path / "sequences" / "07" / "run.json"
    note.write_text(json.dumps(json.loads(note.read_text()) | {key: "another"}))
    with pytest.raises(SettingError, match=key):
        predict(recording, runner, tmp_path)


@pytest.mark.parametrize("text", [None, "{", "[]", json.dumps({"bundle": "other"})])
def test_predictions_of_unknown_origin_are_not_continued(made, runner, tmp_path, text):
    recording = open_recording(made, Options(limit=2))
    predict(recording, runner, tmp_path)
    note = tmp_path / "sequences" / "07" / "run.json"
    note.unlink() if text is None else note.write_text(text)
    with pytest.raises(SettingError, match="`overwrite`"):
        predict(recording, runner, tmp_path)


def test_a_broken_scan_leaves_what_was_finished_and_says_where(folder, runner, whole, tmp_path):
    path = folder / "velodyne" / "000010.bin"
    good = path.read_bytes()
    path.write_bytes(good[:-1])
    with pytest.raises(ScanError, match=r"stopped at scan 000010 \(11 of 13\).*no whole number") as error:
        predict(open_recording(folder), runner, tmp_path / "out")
    assert "same command" in str(error.value)
    assert contents(tmp_path / "out") == {name: whole[name] for name in list(whole)[:10]}
    path.write_bytes(good)
    assert predict(open_recording(folder), runner, tmp_path / "out").resumed == 10
    assert contents(tmp_path / "out") == whole


def test_output_that_cannot_be_written(made, runner, tmp_path):
    (tmp_path / "out").write_text("a file, no folder")
    with pytest.raises(OutputError, match="cannot write"):
        predict(open_recording(made), runner, tmp_path / "out")


def test_a_full_disk_in_the_middle(made, runner, whole, tmp_path):
    recording = open_recording(made)

    def fill(done, total):
        if done == 4:
            disk.enter_context(full_disk(100))

    with contextlib.ExitStack() as disk, pytest.raises(OutputError, match=r"stopped at scan 000004 .*too large"):
        predict(recording, runner, tmp_path, on_progress=fill)
    assert len(contents(tmp_path)) == 4
    predict(recording, runner, tmp_path)
    assert contents(tmp_path) == whole


def test_points_without_direction_are_static(folder, runner, tmp_path):
    path = folder / "velodyne" / "000009.bin"
    scan = np.fromfile(path, np.float32).reshape(-1, 4)
    scan[::3] = 0
    scan[1::3, 0] = np.nan
    scan.tofile(path)
    recording = open_recording(folder)
    predict(recording, runner, tmp_path)
    labels = read_prediction(label_file(tmp_path, recording, 9), len(scan))
    assert (labels[::3] == 9).all()
    assert (labels[1::3] == 9).all()


def test_empty_scans_and_arrays_without_remission(tmp_path, runner):
    folder = tmp_path / "log"
    folder.mkdir()
    for i, pose in enumerate(street.drive(3)):
        scan = street.scan(pose, street.boxes(), rows=8, columns=60)
        np.save(folder / f"{i}.npy", scan[:, :3] if i != 1 else scan[:0])
    street.write_poses(folder / "poses.txt", street.drive(3))
    recording = open_recording(folder, Options(frame="lidar"))
    summary = predict(recording, runner, tmp_path / "out")
    assert summary.scans == 3
    sizes = [label_file(tmp_path / "out", recording, i).stat().st_size for i in range(3)]
    assert sizes[1] == 0
    assert min(sizes[0], sizes[2]) > 0

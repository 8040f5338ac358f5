"""Scores by hand, in every layout, and every input that does not fit."""

import json
import math
import shutil

import numpy as np
import pytest

from runtime.classes import LABELS, MOVERS
from runtime.commands.main import main
from runtime.errors import SequenceError
from runtime.evaluation.evaluate import BINS, Counts, range_bins
from runtime.evaluation.layout import pair
from runtime.evaluation.report import score
from tests.support.dataset import at, write_labels, write_scans
from tests.support.disk import full_disk

# Two frames of one sequence and one of another. Found 3 (car, car, person), missed 2 (car, bus), false alarms 2.
TRUTH = {
    "08": {"000000": [252, 252, 252, 9, 40, 0, 1], "000001": [257, 10, 3 << 16 | 252]},
    "10": {"000000": [254, 99]},
}
GUESS = {
    "08": {"000000": [251, 9, 251, 251, 9, 251, 251], "000001": [9, 251, 0]},
    "10": {"000000": [7 << 16 | 252, 40]},
}
DISTANCES = {
    "08": {"000000": (0, 9.99, 10, 25, 49, 5, 5), "000001": (60, 1000, 30)},
    "10": {"000000": (20, 20)},
}


@pytest.fixture
def truth(tmp_path):
    for name, frames in TRUTH.items():
        write_labels(tmp_path / "kitti" / "sequences" / name / "labels", frames)
        scans = {frame: at(*distances) for frame, distances in DISTANCES[name].items()}
        write_scans(tmp_path / "kitti" / "sequences" / name / "velodyne", scans)
    return tmp_path / "kitti"


@pytest.fixture
def guess(tmp_path):
    for name, frames in GUESS.items():
        write_labels(tmp_path / "out" / "sequences" / name / "predictions", frames)
    return tmp_path / "out"


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")


def test_by_hand(truth, guess):
    report = score(pair(guess, truth))
    assert report["together"] == {
        "frames": 3, "points": 10, "moving": 6, "found": 3, "missed": 3, "false_alarms": 2,
        "iou": 3 / 8, "precision": 3 / 5, "recall": 3 / 6,
    }  # fmt: skip
    assert report["sequences"]["08"]["iou"] == 2 / 7
    assert report["sequences"]["10"] == {
        "frames": 1, "points": 2, "moving": 1, "found": 1, "missed": 0, "false_alarms": 0,
        "iou": 1, "precision": 1, "recall": 1,
    }  # fmt: skip
    assert report["by_class"] == {
        "car": {"label": 252, "points": 4, "found": 2, "recall": 0.5},
        "person": {"label": 254, "points": 1, "found": 1, "recall": 1},
        "bus": {"label": 257, "points": 1, "found": 0, "recall": 0},
    }
    shares = {name: (row["points"], row["iou"], row["recall"]) for name, row in report["by_range"].items()}
    assert shares == {
        "0-10 m": (2, 0.5, 0.5),
        "10-20 m": (1, 1, 1),
        "20-30 m": (3, 0.5, 1),
        "30-40 m": (1, 0, 0),
        "40-50 m": (1, None, None),
        "50+ m": (2, 0, 0),
    }
    assert report["notes"] == []


def test_by_range_and_by_class_sum_to_the_total():
    rng = np.random.default_rng(3)
    counts = Counts()
    for points in (0, 1, 4000):
        labels, predicted = rng.choice(LABELS, (2, points)).astype(np.uint32)
        scan = at(*rng.uniform(0, 80, points))
        scan[: points // 50] = np.nan
        counts.add(labels, predicted, scan)
    parts = counts.by_range().values()
    np.testing.assert_array_equal(sum(part.matrix for part in parts), counts.total().matrix)
    assert all(part.matrix.sum() for part in parts)
    assert sum(counts.recall_of(label)[1] for label in MOVERS) == counts.total().matrix[2].sum()
    assert sum(counts.recall_of(label)[0] for label in MOVERS) == counts.total().movers[0]
    assert counts.frames == 3


def test_a_bin_holds_its_lower_end_and_what_is_not_finite_is_unknown():
    scan = at(0, 9.999, 10, 29.999, 30, 49.999, 50, 3e38)
    assert [BINS[i][:2] for i in range_bins(scan)] == ["0-", "0-", "10", "20", "30", "40", "50", "50"]
    scan[:3, 1] = np.nan, np.inf, -np.inf
    assert [BINS[i] for i in range_bins(scan[:3])] == ["unknown"] * 3


def test_arrays_are_only_read():
    labels, scan = np.array([252, 9], np.uint32), at(3, 4)
    for array in (labels, scan):
        array.setflags(write=False)
    counts = Counts()
    counts.add(labels, labels, scan)
    counts.add(labels[::-1], labels[::-1], scan[::-1])
    assert counts.total().iou == 1


@pytest.mark.parametrize(
    ("predictions", "labels"),
    [
        ("out/sequences/08", "kitti/sequences/08"),
        ("out/sequences/08/predictions", "kitti/sequences/08/labels"),
        ("out/sequences/08", "kitti"),
        ("mine", "kitti/sequences/08"),
    ],
)
def test_one_sequence_in_any_layout(truth, guess, tmp_path, predictions, labels):
    shutil.copytree(guess / "sequences" / "08" / "predictions", tmp_path / "mine")
    report = score(pair(tmp_path / predictions, tmp_path / labels))
    assert list(report["sequences"]) == ["08"]
    assert report["together"]["iou"] == 2 / 7
    assert report["by_range"]["0-10 m"]["points"] == 2


def test_predictions_beside_the_labels_and_picked_sequences(truth, guess):
    shutil.copytree(guess, truth, dirs_exist_ok=True)
    assert set(score(pair(truth, truth))["sequences"]) == {"08", "10"}
    report = score(pair(truth, truth, ("10",)))
    assert set(report["sequences"]) == {"10"}
    assert report["notes"] == ["no predictions of sequence 08: not scored"]
    with pytest.raises(SequenceError, match=r"no predictions of sequence 11; there are 08, 10"):
        pair(guess, truth, ("11",))


def test_predictions_of_scans_without_labels_are_noted(truth, guess):
    write_labels(guess / "sequences" / "10" / "predictions", {"000001": [9], "000002": [9]})
    report = score(pair(guess, truth))
    assert report["together"]["frames"] == 3
    assert report["notes"] == ["sequence 10: 2 predictions of scans without labels are left out"]


def test_without_scans_there_are_no_ranges(truth, guess):
    (truth / "sequences" / "08" / "velodyne" / "000001.bin").unlink()
    report = score(pair(guess, truth))
    assert report["by_range"] is None
    assert "08/000001" in report["by_range_missing"]
    for folder in truth.glob("sequences/*/velodyne"):
        shutil.rmtree(folder)
    report = score(pair(guess, truth))
    assert report["together"]["iou"] == 3 / 8
    assert report["by_range"] is None
    assert report["by_range_missing"] == "no scans beside the labels"


def test_scans_are_found_by_any_spelling_and_folders_are_none(truth, guess):
    scans = truth / "sequences" / "08" / "velodyne"
    (scans / "000001.bin").rename(scans / "000001.BIN")
    (scans / "x.bin").mkdir()
    assert score(pair(guess, truth))["by_range"]["50+ m"]["points"] == 2


def test_nothing_moves(truth, guess, tmp_path, capsys):
    write_labels(truth / "sequences" / "10" / "labels", {"000000": [9, 99]})
    report = score(pair(guess, truth))
    assert report["sequences"]["10"]["iou"] is None
    assert report["sequences"]["10"]["precision"] == 0
    assert report["notes"] == ["in sequence 10 the labels hold no moving point: IoU and recall are undefined there"]
    file = tmp_path / "scores.json"
    assert main(["eval", str(guess), str(truth), "--sequence", "10", "--out", str(file)]) == 0
    assert "the labels hold no moving point: IoU and recall are undefined" in capsys.readouterr().out
    assert json.loads(file.read_text())["together"]["iou"] is None
    write_labels(guess / "sequences" / "10" / "predictions", {"000000": [9, 9]})
    assert score(pair(guess, truth, ("10",)))["together"]["precision"] is None


def test_every_missing_prediction_is_named(truth, guess):
    (guess / "sequences" / "08" / "predictions" / "000001.label").unlink()
    (guess / "sequences" / "10" / "predictions" / "000000.label").unlink()
    with pytest.raises(SequenceError, match=r"(?s)2 problems.*08/predictions/000001.*missing.*10/pred.*missing"):
        pair(guess, truth)


def test_many_problems_are_counted(tmp_path):
    frames = {f"{i:06d}": [9] for i in range(14)}
    truth, guess = write_labels(tmp_path / "labels", frames), write_labels(tmp_path / "predictions", {"0": [9]})
    with pytest.raises(SequenceError, match=r"(?s)14 problems.*000004.label: missing\n  and 9 more$"):
        pair(guess, truth)


def test_predictions_without_labels_are_named(truth, guess):
    write_labels(guess / "sequences" / "11" / "predictions", {"000000": [9]})
    with pytest.raises(SequenceError, match="sequence 11: no labels"):
        pair(guess, truth)
    (truth / "sequences" / "11" / "labels").mkdir(parents=True)
    with pytest.raises(SequenceError, match=r"labels: holds no \.label files"):
        pair(guess, truth)


def test_every_file_that_does_not_fit_is_named(truth, guess):
    write_labels(guess / "sequences" / "08" / "predictions", {"000000": [9, 251], "000001": [2, 2, 260]})
    write_labels(truth / "sequences" / "10" / "labels", {"000000": [9, 300]})
    with pytest.raises(SequenceError) as caught:
        score(pair(guess, truth))
    lines = str(caught.value).split("\n")
    assert lines[0] == "3 problems, so nothing was scored:"
    assert "08/predictions/000000.label: 8 bytes are not the 4-byte labels of 7 points" in lines[1]
    assert "000001.label: unknown labels 2, 260 on 3 of 3 points; write 251" in lines[2]
    assert "10/labels/000000.label: unknown label 300 on 1 of 2 points" in lines[3]


def test_a_mask_of_ones_is_no_prediction(truth, guess):
    write_labels(guess / "sequences" / "10" / "predictions", {"000000": [1, 0]})
    with pytest.raises(
        SequenceError, match="unknown label 1 on 1 of 2 points; seems to hold a mask of zeros and ones;"
    ):
        score(pair(guess, truth))


@pytest.mark.parametrize(
    ("change", "seems"),
    [
        (lambda moving: moving.astype("<f4"), "seems to hold float32; write 251"),
        (lambda moving: np.where(moving, 251, 9).astype(">u4"), "seems to hold big-endian numbers; write 251"),
        (lambda moving: np.where(moving, 251, 9).astype("<i8"), "but so many numbers of 64 bits; write 251"),
    ],
)
def test_predictions_of_another_type_are_not_scored_as_zero(truth, guess, change, seems):
    for file in guess.glob("sequences/*/predictions/*.label"):
        change(np.fromfile(file, "<u4") % 65536 > 250).tofile(file)
    with pytest.raises(SequenceError, match="3 problems") as caught:
        score(pair(guess, truth))
    assert str(caught.value).count(seems) == 3


def test_a_truth_that_is_a_mask_is_not_scored(truth, guess):
    for file in truth.glob("sequences/*/labels/*.label"):
        (np.fromfile(file, "<u4") % 65536 > 250).astype("<u4").tofile(file)
    with pytest.raises(SequenceError, match="none of 7 points has a label other than 0 and 1; seems to hold a mask"):
        score(pair(guess, truth))
    for file in truth.glob("sequences/*/labels/*.label"):
        np.zeros_like(np.fromfile(file, "<u4")).tofile(file)
    with pytest.raises(SequenceError, match="no point has a label other than 0 and 1, so nothing was scored"):
        score(pair(guess, truth))


def test_predictions_in_which_nothing_moves_get_a_sentence(truth, guess, capsys):
    write_labels(guess / "sequences" / "08" / "predictions", {"000000": [9] * 7, "000001": [0, 0, 9]})
    assert score(pair(guess, truth))["notes"] == [
        "no labelled point is predicted as moving (251 to 259) in sequence 08"
    ]
    write_labels(guess / "sequences" / "10" / "predictions", {"000000": [9, 9]})
    assert main(["eval", str(guess), str(truth)]) == 0
    assert "no labelled point is predicted as moving (251 to 259)\n" in capsys.readouterr().out


def test_a_link_has_the_name_that_it_was_given(truth, guess, tmp_path):
    (guess / "sequences" / "08").rename(tmp_path / "elsewhere")
    (guess / "sequences" / "08").symlink_to(tmp_path / "elsewhere")
    (truth / "sequences" / "08").rename(tmp_path / "recorded")
    (truth / "sequences" / "08").symlink_to(tmp_path / "recorded")
    assert score(pair(guess, truth))["together"]["iou"] == 3 / 8
    for folder in ("", "predictions"):
        report = score(pair(guess / "sequences" / "08" / folder, truth))
        assert list(report["sequences"]) == ["08"]
        assert report["by_range"] is not None


def test_files_that_cannot_be_read_or_are_cut_off(truth, guess):
    folder = guess / "sequences" / "08" / "predictions"
    (folder / "000000.label").write_bytes(bytes(5))
    (folder / "000001.label").unlink()
    (folder / "000001.label").mkdir()
    with pytest.raises(SequenceError, match=r"(?s)2 problems.*5 bytes.*cannot be read"):
        score(pair(guess, truth))


def test_scans_of_another_length(truth, guess):
    write_scans(truth / "sequences" / "10" / "velodyne", {"000000": at(1, 2, 3)})
    with pytest.raises(SequenceError, match=r"scan 000000 has 3 points, but .*000000.label labels 2"):
        score(pair(guess, truth))


def test_nothing_there(tmp_path, truth):
    with pytest.raises(SequenceError, match="is no folder; give a root with sequences/NN/predictions"):
        pair(tmp_path / "absent", truth)
    with pytest.raises(SequenceError, match="holds neither sequences/NN/predictions nor"):
        pair(truth, truth)


def test_command(truth, guess, tmp_path, capsys):
    file = tmp_path / "new" / "scores.json"
    assert main(["eval", str(guess), str(truth), "--out", str(file)]) == 0
    shown = capsys.readouterr().out
    for words in (
        ["sequence", "08", "28.57"],
        ["together", "37.50", "60.00", "50.00", "10", "6"],
        ["40-50", "m", "undefined", "undefined", "undefined", "1", "0"],
        ["252", "car", "50.00", "4", "4"],
    ):
        assert any(line.split()[: len(words)] == words for line in shown.splitlines()), words
    assert "recall only" in shown
    report = json.loads(file.read_text())
    assert report["together"]["iou"] == 0.375
    assert not any(isinstance(value, float) and math.isnan(value) for value in report["together"].values())


def test_a_full_disk(truth, guess, tmp_path, capsys):
    with full_disk(100):
        assert main(["eval", str(guess), str(truth), "--out", str(tmp_path / "new" / "scores.json")]) == 1
    assert "scores.json: File too large" in capsys.readouterr().err
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.parametrize("arguments", [["{guess}"], ["{guess}", "{truth}", "--zip", "a.zip", "--out", "a.json"]])
def test_wrong_usage(truth, guess, capsys, arguments):
    assert main(["eval", *(argument.format(guess=guess, truth=truth) for argument in arguments)]) == 2
    assert capsys.readouterr().err


def test_errors_are_told_without_a_traceback(truth, guess, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["eval", str(guess), str(truth), "--out", str(tmp_path / "file" / "scores.json")]) == 1
    assert "mos: cannot write" in capsys.readouterr().err
    assert main(["eval", str(tmp_path / "absent"), str(truth)]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("mos: ")
    assert shown.err.count("\n") == 1

"""What pictures need no Pillow for: what is shown of which scan, and what is refused."""

import sys

import numpy as np
import pytest

from runtime.commands.main import main
from runtime.errors import MissingPackageError, SequenceError, SettingError
from runtime.pictures import Live, Stored, check_output, snapshots, write_picture
from runtime.pictures.drawing import choose_scans
from runtime.pictures.verdict import FALSE_ALARM, FOUND, MISSED, STILL, UNSCORED, legend, verdict
from runtime.recordings.labels import write_labels
from runtime.recordings.registry import open_recording
from tests.support import street
from tests.support.paths import TINY

SCANS = TINY / "scans" / "sequences" / "00"


@pytest.fixture(scope="module")
def sequence():
    return open_recording(SCANS)


class CountingRunner:
    """Stands for a runner: a point moves if its number is the number of scans remembered before it."""

    history_length = 8
    sensor = "any"

    class bundle:
        class manifest:
            name = "counting"

            class sensor:
                class range_image:
                    mean = (0.0,) * 5

    def __init__(self):
        self.scans = []

    def reset(self, keep_sensor=False):
        self.scans = []

    def remember(self, scan):
        self.scans = [*self.scans, scan.data][-8:]

    def __call__(self, scan):
        class Result:
            moving = np.arange(len(scan.data)) == len(self.scans)

        self.past = [points.sum() for points in self.scans]
        self.remember(scan)
        return Result


def test_verdict_of_every_case():
    classes = np.array([0, 0, 1, 1, 2, 2], np.uint8)
    moving = np.array([0, 1, 0, 1, 0, 1], bool)
    want = [UNSCORED, UNSCORED, STILL, FALSE_ALARM, MISSED, FOUND]
    assert verdict(moving, classes).tolist() == want
    assert verdict(moving, None).tolist() == [STILL, FOUND] * 3
    assert verdict(None, classes).tolist() == [UNSCORED, UNSCORED, STILL, STILL, FOUND, FOUND]
    with pytest.raises(ValueError, match="nothing to show"):
        verdict(None, None)
    assert {kind for kind, _ in legend(True, True)} == {FOUND, MISSED, FALSE_ALARM, STILL}
    assert [text for _, text in legend(True, False)] == ["moving", "static"]


def test_snapshots_hold_points_truth_and_predictions(sequence, tmp_path):
    scan = sequence.read(4)
    points, pose = scan.points, scan.pose
    moving = np.arange(len(points)) % 3 == 0
    write_labels(tmp_path / "ours" / "sequences" / "00" / "predictions" / "000004.label", moving)
    (shown,) = snapshots(sequence, [Stored(tmp_path / "ours", sequence)], [4])
    assert (shown.sequence, shown.index, shown.scan, list(shown.moving)) == ("00", 4, "000004", ["ours"])
    np.testing.assert_array_equal(shown.points, points)
    np.testing.assert_array_equal(shown.pose, pose)
    np.testing.assert_array_equal(shown.moving["ours"], moving)
    raw = np.fromfile(SCANS / "labels" / "000004.label", np.uint32) & 0xFFFF
    np.testing.assert_array_equal(shown.classes == 2, raw > 250)
    hit, union = ((raw > 250) & moving).sum(), ((raw > 250) | (moving & (raw > 1))).sum()
    assert hit > 0
    assert shown.iou("ours") == hit / union


def test_without_labels_there_is_no_score(tmp_path):
    folder = street.write_kitti(tmp_path / "07", 2, rows=8, columns=60)
    sequence = open_recording(folder)
    write_labels(tmp_path / "p" / "000001.label", np.zeros(len(sequence.read(1).data), bool))
    (shown,) = snapshots(sequence, [Stored(tmp_path / "p", sequence, "mine")], [1])
    assert shown.classes is None
    assert shown.iou("mine") is None
    with pytest.raises(SequenceError, match="neither predictions nor labels"):
        next(snapshots(sequence, [], [0]))


def test_systems_of_one_name_stay_apart(sequence, tmp_path):
    for place, value in (("a", False), ("b", True)):
        write_labels(tmp_path / place / "same" / "000000.label", np.full(len(sequence.read(0).data), value))
    systems = [Stored(tmp_path / place / "same", sequence) for place in ("a", "b")]
    (shown,) = snapshots(sequence, systems, [0])
    assert {name: bool(moving.any()) for name, moving in shown.moving.items()} == {"same (1)": False, "same (2)": True}


def test_a_runner_is_asked_with_the_scans_before(sequence):
    runner = CountingRunner()
    shown = list(snapshots(sequence, [Live(runner, sequence)], [3, 4, 8]))
    assert [np.flatnonzero(one.moving["counting"]).tolist() for one in shown] == [[3], [4], [8]]
    np.testing.assert_array_equal(runner.past, [sequence.read(i).data.sum() for i in range(8)])


def test_predictions_that_do_not_fit_are_named(sequence, tmp_path):
    points = len(sequence.read(0).data)
    write_labels(tmp_path / "p" / "000000.label", np.zeros(points - 1, bool))
    stored = Stored(tmp_path / "p", sequence)
    with pytest.raises(SequenceError, match=rf"000000.label: .*{points} points"):
        list(snapshots(sequence, [stored], [0]))
    with pytest.raises(SequenceError, match=r"000001.label: there is no prediction"):
        list(snapshots(sequence, [stored], [1]))
    with pytest.raises(SequenceError, match="is no folder"):
        Stored(tmp_path / "absent", sequence)
    for name in ("01", "02"):
        write_labels(tmp_path / "other" / "sequences" / name / "predictions" / "000000.label", np.zeros(3, bool))
    with pytest.raises(SequenceError, match="no predictions of sequence 00; there are 01, 02"):
        Stored(tmp_path / "other", sequence)


@pytest.mark.parametrize("change", [lambda moving: moving.astype("<f4"), lambda moving: moving.astype("<u4")])
def test_what_holds_no_labels_is_not_drawn(sequence, tmp_path, change):
    points = sequence.count(0)
    (tmp_path / "p").mkdir()
    change(np.arange(points) % 5 == 0).tofile(tmp_path / "p" / "000000.label")
    with pytest.raises(SequenceError, match=r"000000\.label: .*; seems to hold .*; write 251 for moving"):
        list(snapshots(sequence, [Stored(tmp_path / "p", sequence)], [0]))


def test_a_truth_that_holds_no_labels_is_not_drawn(tmp_path):
    folder = street.write_kitti(tmp_path / "07", 1, rows=8, columns=60)
    sequence = open_recording(folder)
    (folder / "labels").mkdir()
    np.ones(sequence.count(0), "<f4").tofile(folder / "labels" / "000000.label")
    with pytest.raises(SequenceError, match=r"000000\.label: .*; seems to hold float32; are these labels"):
        list(snapshots(sequence, [], [0]))


def test_choice_of_scans(sequence):
    assert choose_scans(sequence, ".png", None, None) == range(8, 9)  # the first one with a full history
    assert choose_scans(sequence, ".gif", None, None) == range(9)
    assert choose_scans(sequence, ".gif", 2, 3) == range(2, 5)
    for number in (-1, 9):
        with pytest.raises(SettingError, match=f"no scan {number}: sequence 00 has the scans 0 to 8"):
            choose_scans(sequence, ".gif", number, 1)
    with pytest.raises(SettingError, match="count must be at least 1, not 0"):
        choose_scans(sequence, ".gif", 2, 0)


@pytest.mark.parametrize(("package", "file"), [("PIL", "a.png"), ("PIL", "a.gif"), ("rerun", "a.rrd")])
def test_a_missing_package_names_the_extra(package, file, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackageError, match=r"pip install 'lidar-mos\[view\]'"):
        check_output(file)
    with pytest.raises(MissingPackageError):
        write_picture(tmp_path / file, [])
    assert main(["view", str(SCANS), "--out", str(tmp_path / file)]) == 1
    shown = capsys.readouterr().err
    assert shown.startswith("mos: ")
    assert "lidar-mos[view]" in shown
    assert shown.count("\n") == 1


def test_only_known_kinds_of_files():
    with pytest.raises(SettingError, match=r"a.jpg: .*\.png .*\.gif .*\.rrd"):
        check_output("a.jpg")

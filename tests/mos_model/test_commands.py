"""`mos demo` and `mos simulate`."""

import sys

import numpy as np
import pytest

from mos_model.commands import demo, simulate
from mos_model.simulator.demo import run_demo
from runtime.classes import to_classes
from runtime.commands.handler import run_alone
from runtime.errors import OutputError
from runtime.evaluation.confusion import Confusion
from runtime.recordings.labels import read_prediction, read_truth
from tests.support.paths import BUNDLE


@pytest.fixture
def no_pillow(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)


def test_the_demo_shows_scores_and_speed_and_goes_on_without_pillow(tmp_path, capsys, monkeypatch, no_pillow):
    monkeypatch.setenv("COLUMNS", "200")
    out = tmp_path / "demo"
    assert run_alone(demo, "mos demo", ["--out", str(out), "--scans", "3", "--bundle", str(BUNDLE)]) == 0
    shown = capsys.readouterr()
    for text in ("IoU", "precision", "95th percentile", "scans a second", "lidar-mos[view]", "of 3 scans"):
        assert text in shown.out
    for command in ("mos doctor", "mos run", "mos view", f"mos eval {out / 'predictions'} {out / 'street'}"):
        assert command in shown.out
    for stage in ("simulate a street", "load the network", "find what moves"):
        assert stage in shown.err
    assert len(list((out / "predictions" / "sequences" / "00" / "predictions").glob("*.label"))) == 3


def test_scores_are_those_of_the_files(tmp_path, no_pillow):
    stages = []
    done = run_demo(tmp_path / "demo", 2, BUNDLE, 1, lambda *a: stages.append(a))
    assert done.no_pictures
    assert done.pictures == ()
    want = Confusion()
    for name in ("000000.label", "000001.label"):
        true = read_truth(done.sequence / "labels" / name)
        want.add(to_classes(true), to_classes(read_prediction(done.summary.folder / name, len(true))))
    np.testing.assert_array_equal(done.scores.matrix, want.matrix)
    assert want.matrix.sum() == done.summary.points
    assert [(stage, done, total) for stage, done, total, _ in stages if stage == "find what moves"] == [
        ("find what moves", i, 2) for i in range(3)
    ]

    before = (done.sequence / "velodyne" / "000001.bin").stat().st_mtime_ns
    again = run_demo(tmp_path / "demo", 2, BUNDLE, 1)  # takes the street that is there, and labels it anew
    assert (done.sequence / "velodyne" / "000001.bin").stat().st_mtime_ns == before
    assert again.summary.scans == 2
    with pytest.raises(OutputError, match="other settings"):
        run_demo(tmp_path / "demo", 3, BUNDLE, 1)


def test_somebody_elses_folder_is_left_alone(tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file.txt").write_text("precious")
    (tmp_path / "file").write_text("precious")
    for name in ("mine", "file"):
        assert run_alone(demo, "mos demo", ["--out", str(tmp_path / name), "--scans", "1"]) == 1
        shown = capsys.readouterr().err
        assert "mos: " in shown
        assert "--out" in shown
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["file.txt"]
    with pytest.raises(OutputError, match="cannot write"):
        run_demo(tmp_path / "file" / "demo", 1)


def test_simulate_says_what_it_wrote(tmp_path, capsys):
    arguments = [str(tmp_path / "data"), "--frames", "2", "--sensor", "vlp16", "--weather", "fog"]
    assert run_alone(simulate, "mos simulate", arguments) == 0
    assert f"{tmp_path / 'data'}: 2 scans in 1 sequences, " in capsys.readouterr().out
    assert run_alone(simulate, "mos simulate", arguments) == 1
    assert "exists already" in capsys.readouterr().err

"""`mos` on recordings without poses."""

import importlib.util
import shutil

import numpy as np
import pytest

from runtime.commands.main import main
from tests.support import street
from tests.support.paths import BUNDLE


@pytest.fixture
def without(tmp_path):
    """A folder of scans without poses."""
    folder = street.write_kitti(tmp_path / "07", 6, rows=16, columns=240)
    (folder / "poses.txt").unlink()
    (folder / "calib.txt").unlink()
    return folder


def files(out):
    return {path.name: path.read_bytes() for path in (out / "sequences" / "07").rglob("*") if path.is_file()}


def test_poses_are_found_by_kiss_icp_and_a_run_goes_on_with_them(without, tmp_path, capsys):
    pytest.importorskip("kiss_icp")
    arguments = ["run", str(without), "--bundle", str(BUNDLE), "--threads", "1", "--out"]
    assert main([*arguments, str(tmp_path / "whole")]) == 0
    assert "no poses are given: they are found by KISS-ICP" in capsys.readouterr().err
    whole = files(tmp_path / "whole")
    assert {"poses.txt", "poses.tum", "calib.txt", "odometry.json", "000005.label"} <= whole.keys()
    # a run that was killed
    shutil.copytree(tmp_path / "whole", tmp_path / "part")
    part = tmp_path / "part" / "sequences" / "07"
    for name in ("000004", "000005"):
        (part / "predictions" / f"{name}.label").unlink()
    for lost in ((), ("odometry.json", "poses.txt", "poses.tum", "calib.txt")):
        for name in lost:
            (part / name).unlink()
        assert main([*arguments, str(tmp_path / "part")]) == 0
        assert {**files(tmp_path / "part"), "scans.jsonl": b""} == {**whole, "scans.jsonl": b""}
    # the poses that were written are those that were used
    given = ["--poses", str(part / "poses.txt"), "--calib", str(part / "calib.txt")]
    assert main([*arguments, str(tmp_path / "given"), *given]) == 0
    labels = {name: data for name, data in files(tmp_path / "given").items() if name.endswith(".label")}
    assert labels == {name: whole[name] for name in labels}


def test_doctor_and_view_find_them_too(without, tmp_path, capsys):
    pytest.importorskip("kiss_icp")
    pytest.importorskip("PIL")
    main(["doctor", str(without), "--bundle", str(BUNDLE)])
    assert "no poses; those of 6 scans by KISS-ICP" in capsys.readouterr().out
    assert main(["view", str(without), "--bundle", str(BUNDLE), "--out", str(tmp_path / "x.png")]) == 0


def test_odometry_may_be_refused_or_asked_for(without, capsys):
    drawing = ["view"] if importlib.util.find_spec("PIL") else []
    for command in ("run", "doctor", *drawing):
        assert main([command, str(without), "--odometry", "none"]) == 1
        said = "".join(capsys.readouterr())
        assert ("1 bad" if command == "doctor" else "or find them (--odometry kiss)") in said
        assert main([command, str(without), "--odometry", "kiss", "--poses", "x"]) == 2
        assert "--odometry kiss finds the poses" in capsys.readouterr().err


def test_poses_that_are_given_are_used_unless_others_are_asked_for(tmp_path, capsys):
    pytest.importorskip("kiss_icp")
    folder = street.write_kitti(tmp_path / "07", 2, rows=16, columns=240)
    arguments = ["run", str(folder), "--bundle", str(BUNDLE), "--threads", "1", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert "KISS" not in capsys.readouterr().err
    assert main([*arguments, "--odometry", "kiss"]) == 1
    assert "poses differ" in capsys.readouterr().err
    assert main([*arguments, "--odometry", "kiss", "--overwrite"]) == 0
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "out/sequences/07/poses.txt")[0], np.eye(4)[:3].ravel())


def test_without_the_package_poses_are_missed_as_before(without, capsys, monkeypatch):
    monkeypatch.setattr("runtime.compute.packages.find_spec", lambda name: None)
    assert main(["run", str(without), "--bundle", str(BUNDLE)]) == 1
    assert "no poses: " in capsys.readouterr().err
    assert main(["run", str(without), "--bundle", str(BUNDLE), "--odometry", "kiss"]) == 1
    assert "pip install 'lidar-mos[odometry]'" in capsys.readouterr().err

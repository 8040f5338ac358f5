"""`mos run` of several recordings."""

import re

import pytest

from runtime.commands.main import main
from tests.support import street
from tests.support.paths import BUNDLE

COUNT = 4


@pytest.fixture
def root(tmp_path):
    """The first of two recordings has a broken scan."""
    for name in ("01", "02"):
        street.write_kitti(tmp_path / "root" / "sequences" / name, COUNT, rows=16, columns=120)
    file = tmp_path / "root" / "sequences" / "01" / "velodyne" / "000002.bin"
    file.write_bytes(file.read_bytes()[:-5])
    return tmp_path / "root"


def labels(out, name):
    return sorted(path.stem for path in (out / "sequences" / name / "predictions").glob("*.label"))


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_one_that_is_broken_does_not_stop_the_others(root, tmp_path, capsys, jobs):
    out = tmp_path / "out"
    arguments = ["run", str(root), "--out", str(out), "--bundle", str(BUNDLE), "--jobs", jobs]
    assert main(arguments) == 1
    assert (len(labels(out, "01")), len(labels(out, "02"))) == (2, COUNT)
    shown = capsys.readouterr()
    assert re.search(r"^mos: 01: stopped at scan 000002", shown.err, re.MULTILINE)
    assert re.search(r"^mos: 1 of 2 recordings are not labelled.*: 01 \(stopped", shown.err, re.MULTILINE)
    assert re.search(r"^01 +failed", shown.out, re.MULTILINE)
    assert re.search(rf"^02 +{COUNT} +0 +\d.* %? +0 +[\d.]+ +\S+", shown.out, re.MULTILINE)
    assert "Traceback" not in shown.err

    if jobs == "1":  # repaired, the same command goes on
        whole = root / "sequences" / "02" / "velodyne" / "000002.bin"
        (root / "sequences" / "01" / "velodyne" / "000002.bin").write_bytes(whole.read_bytes())
        assert main(arguments) == 0
        assert labels(out, "01") == labels(out, "02")
        assert re.search(rf"^01 +{COUNT} +2 .*\n02 +{COUNT} +{COUNT} +- ", capsys.readouterr().out, re.MULTILINE)


def test_two_of_one_name_are_an_error_before_anything_is_written(root, tmp_path, capsys):
    street.write_kitti(tmp_path / "other" / "02", 2, rows=4, columns=20)
    out = tmp_path / "out"
    arguments = ["run", str(root / "sequences" / "*"), str(tmp_path / "other"), "--out", str(out)]
    assert main([*arguments, "--bundle", str(BUNDLE)]) == 1
    said = capsys.readouterr().err
    assert said.startswith("mos: ")
    assert "other/02 have one name" in said
    assert not out.exists()


def test_patterns_folders_and_pieces(root, tmp_path, capsys):
    """The same command, in pieces or not, goes on; a table says what became of each."""
    out = tmp_path / "out"
    arguments = ["run", str(root / "sequences" / "0[2-9]"), "--out", str(out), "--bundle", str(BUNDLE)]
    assert main([*arguments, "--piece", "3", "--write", "cloud"]) == 0
    assert labels(out, "02") == [f"{i:06d}" for i in range(COUNT)]
    shown = capsys.readouterr()
    assert re.search(rf"^02 +{COUNT} +0 +\d", shown.out, re.MULTILINE)
    assert shown.err.count("clouds: ") == 1
    assert main([*arguments, "--jobs", "2"]) == 0
    assert re.search(rf"^02 +{COUNT} +{COUNT} +- ", capsys.readouterr().out, re.MULTILINE)
    assert main([*arguments, "--piece", "0"]) == 2
    assert main(["run", "gs://bucket/logs", "--out", str(out)]) == 2
    assert "s3://BUCKET/KEY" in capsys.readouterr().err

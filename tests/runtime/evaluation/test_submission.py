"""The archive of the benchmark: what a server would look for is in it, and nothing broken is packed."""

import os
import zipfile

import numpy as np
import pytest

from runtime.commands.main import main
from runtime.errors import MosWarning, OutputError, SequenceError, SettingError
from runtime.evaluation import submission
from runtime.evaluation.submission import TEST_SCANS, check, pack
from tests.support.dataset import at, write_labels, write_scans
from tests.support.disk import full_disk

LENGTHS = {name: (3, 5) for name in TEST_SCANS}  # points of each scan


def points(name, index):
    return LENGTHS[name][index]


def labels(name, index):
    return np.where(np.arange(points(name, index)) % 2, 251, 9)


@pytest.fixture
def short(monkeypatch):
    """A benchmark of sequences of two scans."""
    monkeypatch.setattr(submission, "TEST_SCANS", dict.fromkeys(TEST_SCANS, 2))


@pytest.fixture
def root(tmp_path, short):
    """Sequences 11 to 21 of two scans each."""
    for name in TEST_SCANS:
        scans = {f"{i:06d}": at(*range(1, points(name, i) + 1)) for i in range(2)}
        write_scans(tmp_path / "kitti" / "sequences" / name / "velodyne", scans)
    return tmp_path / "kitti"


@pytest.fixture
def guess(tmp_path):
    for name in (*TEST_SCANS, "08"):
        frames = {f"{i:06d}": labels(name if name != "08" else "11", i) for i in range(2)}
        write_labels(tmp_path / "out" / "sequences" / name / "predictions", frames)
    return tmp_path / "out"


def folder(guess, name):
    return guess / "sequences" / name / "predictions"


def test_the_archive_is_what_the_server_looks_for(root, guess, tmp_path):
    file = tmp_path / "new" / "mine.zip"
    calls = []
    pack(check(guess, root), file, lambda *call: calls.append(call))
    assert calls == [(i, 22) for i in range(1, 23)]
    with zipfile.ZipFile(file) as archive:
        assert archive.testzip() is None
        names = set(archive.namelist())
        wanted = {"sequences/"}
        for name in TEST_SCANS:
            wanted |= {f"sequences/{name}/", f"sequences/{name}/predictions/"}
            for i in range(2):
                path = f"sequences/{name}/predictions/{i:06d}.label"
                wanted.add(path)
                np.testing.assert_array_equal(np.frombuffer(archive.read(path), "<u4"), labels(name, i))
        assert names == wanted
    again = tmp_path / "again.zip"
    pack(check(guess, root), again)
    assert again.read_bytes() == file.read_bytes()


def test_a_sequence_that_is_missing(root, guess, tmp_path):
    for file in folder(guess, "13").iterdir():
        file.unlink()
    folder(guess, "13").rmdir()
    with pytest.raises(SequenceError, match="no predictions of sequence 13; the server wants all of 11 to 21"):
        check(guess, root)
    assert list(check(guess, root, ("11", "12")).files) == ["11", "12"]


def test_every_file_that_does_not_fit_the_scans_is_named(root, guess):
    (folder(guess, "12") / "000001.label").unlink()
    write_labels(folder(guess, "11"), {"000000": [9] * 4, "000007": [9]})
    with pytest.raises(SequenceError) as caught:
        check(guess, root)
    lines = str(caught.value).split("\n")
    assert lines[0] == "3 problems, so nothing was packed:"
    assert "11/predictions/000000.label: 16 bytes are not the 4-byte labels of 3 points" in lines[1]
    assert "11/predictions/000007.label: there is no scan of this name" in lines[2]
    assert "12/predictions/000001.label: missing" in lines[3]


def test_a_root_without_the_scans(root, guess, tmp_path):
    with pytest.raises(SequenceError, match="sequence 08: no scans under"):
        check(guess, root, ("08", "11"))
    with pytest.raises(SequenceError, match="holds no recording"):
        check(guess, guess)


def test_one_sequence_of_any_name(root, guess):
    assert list(check(guess, root / "sequences" / "11", ("08",)).files) == ["08"]


def test_a_root_that_lacks_scans_of_the_benchmark(root, guess):
    for file in (root / "sequences" / "14" / "velodyne" / "000001.bin", folder(guess, "14") / "000001.label"):
        file.unlink()
    with pytest.raises(SequenceError, match=r"^1 problem, (?s:.)*14/predictions/000001.label: missing$"):
        check(guess, root)
    assert len(check(guess, root, ("14",)).files["14"]) == 1


def test_without_scans_gaps_show(guess, short):
    assert len(check(guess).files) == 11
    (folder(guess, "21") / "000000.label").unlink()
    write_labels(folder(guess, "20"), {"000002": [9]})
    with pytest.raises(SequenceError, match=r"(?s)2 problems.*20.*000002.*no scan of this name.*21.*missing"):
        check(guess)
    (folder(guess, "08") / "000000.label").unlink()
    with pytest.raises(SequenceError, match=r"08/predictions/000000.label: missing"):
        check(guess, names=("08",))
    (folder(guess, "08") / "000001.label").unlink()
    with pytest.raises(SequenceError, match=r"holds no \.label files"):
        check(guess, names=("08",))


def test_the_benchmark_has_20351_test_scans(guess):
    assert sum(TEST_SCANS.values()) == 20351
    with pytest.raises(SequenceError, match=r"11/predictions/000002.label: missing(?s:.)*and 20324 more"):
        check(guess)


def test_unknown_labels_leave_no_archive_and_an_older_one_as_it_was(root, guess, tmp_path):
    file = tmp_path / "mine.zip"
    file.write_text("older")
    write_labels(folder(guess, "11"), {"000001": [0, 9, 251, 2, 1]})
    write_labels(folder(guess, "21"), {"000000": [77, 9, 9]})
    with pytest.raises(SequenceError) as caught:
        pack(check(guess, root), file)
    assert "11/predictions/000001.label: unknown labels 1, 2 on 2 of 5 points" in str(caught.value)
    assert "21/predictions/000000.label: unknown label 77 on 1 of 3 points" in str(caught.value)
    assert file.read_text() == "older"
    assert sorted(os.listdir(tmp_path)) == ["kitti", "mine.zip", "out"]


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda labels: (labels > 250).astype("<f4"), "float32"),
        (lambda labels: labels.astype(">u4"), "big-endian numbers"),
    ],
)
@pytest.mark.parametrize("known", [True, False])
def test_predictions_of_another_type_are_not_packed(root, guess, tmp_path, change, kind, known):
    for i in range(2):
        change(labels("12", i)).tofile(folder(guess, "12") / f"{i:06d}.label")
    with pytest.raises(SequenceError, match=f"(?s)2 problems.*12/predictions/000000.label.*seems to hold {kind}"):
        pack(check(guess, root if known else None), tmp_path / "mine.zip")
    assert not (tmp_path / "mine.zip").exists()


def test_a_submission_in_which_nothing_moves_gets_a_sentence(root, guess, tmp_path, capsys):
    for name in TEST_SCANS:
        if name != "17":
            write_labels(folder(guess, name), {f"{i:06d}": [9] * points(name, i) for i in range(2)})
    with pytest.warns(MosWarning, match=r"sequence 11, 12, 13 and 7 more is labelled as moving \(251 to 259\)"):
        pack(check(guess, root), tmp_path / "mine.zip")
    write_labels(folder(guess, "17"), {f"{i:06d}": [9] * points("17", i) for i in range(2)})
    assert main(["eval", str(guess), str(root), "--zip", str(tmp_path / "mine.zip")]) == 0
    assert "mine.zip: no point of any sequence is labelled as moving" in capsys.readouterr().err


def test_files_that_cannot_be_read(root, guess, tmp_path):
    (folder(guess, "08") / "000000.label").write_bytes(bytes(10))
    with pytest.raises(SequenceError, match="10 bytes"):
        pack(check(guess, names=("08",)), tmp_path / "mine.zip")


def test_where_it_cannot_be_written(root, guess, tmp_path):
    found = check(guess, root)
    with pytest.raises(SettingError, match=r"ends with \.zip"):
        pack(found, tmp_path / "mine.tar")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        pack(found, tmp_path / "file" / "mine.zip")
    with full_disk(3000), pytest.raises(OutputError, match="File too large"):
        pack(found, tmp_path / "mine.zip")
    assert sorted(os.listdir(tmp_path)) == ["file", "kitti", "out"]


def test_command(root, guess, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    file = tmp_path / "mine.zip"
    assert main(["eval", str(guess), str(root), "--zip", str(file)]) == 0
    shown = capsys.readouterr().out
    assert "sequence 21: 2 scans" in shown
    assert f"packed: {file}" in shown
    assert main(["eval", str(guess), "--sequence", "08", "--zip", str(tmp_path / "other.zip")]) == 0
    assert "not checked: lengths" in capsys.readouterr().out
    assert main(["eval", str(guess), "--zip", str(tmp_path / "other.zip"), "--sequence", "07"]) == 1
    assert capsys.readouterr().err.startswith("mos: ")

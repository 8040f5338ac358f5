import os

import numpy as np
import pytest

from runtime.errors import OutputError, SequenceError
from runtime.recordings.labels import read_prediction, read_truth, write_labels
from tests.support.disk import full_disk
from tests.support.paths import SHARED


def test_written_labels_are_semantickitti(tmp_path):
    path = tmp_path / "new" / "000000.label"
    write_labels(path, np.array([True, False, True]))
    assert path.read_bytes() == np.array([251, 9, 251], "<u4").tobytes()
    np.testing.assert_array_equal(read_prediction(path, 3), [251, 9, 251])
    assert os.listdir(path.parent) == ["000000.label"]


def test_empty_scan(tmp_path):
    write_labels(tmp_path / "0.label", np.empty(0, bool))
    assert read_prediction(tmp_path / "0.label", 0).shape == (0,)


def test_wrong_size(tmp_path):
    path = tmp_path / "0.label"
    path.write_bytes(bytes(10))
    with pytest.raises(SequenceError, match="10 bytes"):
        read_prediction(path)
    path.write_bytes(bytes(12))
    with pytest.raises(SequenceError, match="4 points"):
        read_prediction(path, 4)
    with pytest.raises(SequenceError, match="cannot be read"):
        read_prediction(tmp_path / "1.label")


def test_a_full_disk_leaves_the_old_file_and_no_trace(tmp_path):
    path = tmp_path / "0.label"
    write_labels(path, np.array([True]))
    with full_disk(7), pytest.raises(OutputError, match="cannot write"):
        write_labels(path, np.array([False, False]))
    np.testing.assert_array_equal(read_prediction(path), [251])
    assert os.listdir(tmp_path) == ["0.label"]


def test_a_file_in_the_way_of_the_folder(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        write_labels(tmp_path / "out" / "0.label", np.array([True]))


def some_labels(points=3000, seed=0):
    """Of a scan, as `read_truth` may find them: static kinds, movers with numbers of objects, unlabelled points."""
    rng = np.random.default_rng(seed)
    labels = rng.choice(np.array([0, 1, 9, 40, 48, 72], np.uint32), points)
    labels[::7] = (10, 252, 259)[seed % 3] | np.arange(len(labels[::7])) % 50 << 16
    return labels


OTHERS = {
    "float32 0/1": (lambda moving: moving.astype("<f4"), "float32"),
    "float32 9/251": (lambda moving: np.where(moving, 251, 9).astype("<f4"), "float32"),
    "float32 of probabilities": (lambda moving: np.where(moving, 0.93, 1e-9).astype("<f4"), "float32"),
    "big-endian": (lambda moving: np.where(moving, 251, 9).astype(">u4"), "big-endian"),
    "big-endian mask": (lambda moving: moving.astype(">u4"), "big-endian"),
    "mask": (lambda moving: moving.astype("<u4"), "a mask of zeros and ones"),
    "classes": (lambda moving: np.where(moving, 2, 1).astype("<u4"), "the classes of a network"),
}
SIZES = {
    "int64": (lambda moving: np.where(moving, 251, 9), "numbers of 64 bits", "64 bits"),
    "float64": (lambda moving: moving.astype("<f8"), "numbers of 64 bits", "float64"),
    "uint16": (lambda moving: np.where(moving, 251, 9).astype("<u2"), "numbers of 16 bits", "16 bits"),
    "bytes": (lambda moving: np.where(moving, 251, 9).astype("u1"), "numbers of 8 bits", "8 bits"),
    "mask of bytes": (lambda moving: moving, "numbers of 8 bits", "8 bits"),
}
MASKS = {
    "many": np.random.default_rng(1).random(4000) < 0.5,
    "few": np.arange(4000) % 500 == 2,
    "all": np.ones(4000, bool),
}


@pytest.mark.parametrize("moving", MASKS.values(), ids=MASKS)
@pytest.mark.parametrize("read", [read_prediction, read_truth])
@pytest.mark.parametrize(("change", "kind"), OTHERS.values(), ids=OTHERS)
def test_values_of_another_type_are_named(tmp_path, moving, read, change, kind):
    change(moving).tofile(tmp_path / "0.label")
    with pytest.raises(SequenceError, match=rf"0\.label: .*; seems to hold {kind}"):
        read(tmp_path / "0.label", 4000)


@pytest.mark.parametrize("moving", MASKS.values(), ids=MASKS)
@pytest.mark.parametrize("read", [read_prediction, read_truth])
@pytest.mark.parametrize(("change", "known", "guessed"), SIZES.values(), ids=SIZES)
def test_values_of_another_size_are_named(tmp_path, moving, read, change, known, guessed):
    change(moving).tofile(tmp_path / "0.label")
    with pytest.raises(SequenceError, match=f"labels of 4000 points, but so many {known}; "):
        read(tmp_path / "0.label", 4000)
    with pytest.raises(SequenceError, match=rf"0\.label: .*seems to hold .*{guessed}"):
        read(tmp_path / "0.label")


@pytest.mark.parametrize("seed", range(3))
def test_labels_are_taken_for_labels(tmp_path, seed):
    path, labels = tmp_path / "0.label", some_labels(seed=seed)
    labels.tofile(path)
    np.testing.assert_array_equal(read_truth(path), labels)
    with pytest.raises(SequenceError, match=r"unknown label 1 on \d+ of 3000 points; write 251 for moving and 9"):
        read_prediction(path)
    labels[labels == 1] = 0
    labels.tofile(path)
    np.testing.assert_array_equal(read_prediction(path, 3000), labels)


@pytest.mark.parametrize("read", [read_prediction, read_truth])
@pytest.mark.parametrize("label", [0, 9, 251])
def test_a_scan_of_one_label(tmp_path, read, label):
    np.full(1000, label, "<u4").tofile(tmp_path / "0.label")
    assert (read(tmp_path / "0.label") == label).all()


def test_numbers_that_are_not_finite_are_no_labels(tmp_path):
    """And numpy does not warn of those that signal."""
    np.array([0x7F800001, 0x3F000000, 0x7F800000] * 30, "<u4").tofile(tmp_path / "0.label")  # NaN, 0.5, infinity
    with pytest.raises(SequenceError, match=r"unknown label|none of"):
        read_truth(tmp_path / "0.label")


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the real scans in ../shared")
def test_real_labels_are_taken_for_labels():
    files = sorted(SHARED.glob("data/*/sequences/*/labels/*.label"))
    assert len(files) >= 90
    for file in files:
        np.testing.assert_array_equal(read_truth(file), np.fromfile(file, "<u4"))

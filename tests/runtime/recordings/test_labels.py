import os

import numpy as np
import pytest

from runtime.errors import OutputError, SequenceError
from runtime.recordings.labels import read_labels, write_labels
from tests.support.disk import full_disk


def test_written_labels_are_semantickitti(tmp_path):
    path = tmp_path / "new" / "000000.label"
    write_labels(path, np.array([True, False, True]))
    assert path.read_bytes() == np.array([251, 9, 251], "<u4").tobytes()
    np.testing.assert_array_equal(read_labels(path, 3), [251, 9, 251])
    assert os.listdir(path.parent) == ["000000.label"]


def test_empty_scan(tmp_path):
    write_labels(tmp_path / "0.label", np.empty(0, bool))
    assert read_labels(tmp_path / "0.label", 0).shape == (0,)


def test_wrong_size(tmp_path):
    path = tmp_path / "0.label"
    path.write_bytes(bytes(10))
    with pytest.raises(SequenceError, match="10 bytes"):
        read_labels(path)
    path.write_bytes(bytes(12))
    with pytest.raises(SequenceError, match="4 points"):
        read_labels(path, 4)
    with pytest.raises(SequenceError, match="cannot be read"):
        read_labels(tmp_path / "1.label")


def test_a_full_disk_leaves_the_old_file_and_no_trace(tmp_path):
    path = tmp_path / "0.label"
    write_labels(path, np.array([True]))
    with full_disk(7), pytest.raises(OutputError, match="cannot write"):
        write_labels(path, np.array([False, False]))
    np.testing.assert_array_equal(read_labels(path), [251])
    assert os.listdir(tmp_path) == ["0.label"]


def test_a_file_in_the_way_of_the_folder(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        write_labels(tmp_path / "out" / "0.label", np.array([True]))

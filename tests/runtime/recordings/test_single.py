"""One file is a recording of one scan."""

import numpy as np
import pytest

from runtime.commands.main import main
from runtime.errors import MosWarning, SequenceError
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support.paths import BUNDLE


def test_one_of_the_scans_of_a_folder(folder, tmp_path):
    path = folder / "velodyne" / "000003.bin"
    with pytest.warns(MosWarning, match=r"shows only in several: give the folder .*\(5 more are beside it\)"):
        recording = open_recording(path)
    assert (recording.name, recording.source, recording.keys) == ("000003", str(path), ("000003",))
    np.testing.assert_array_equal(recording.read(0).data, np.fromfile(path, np.float32).reshape(-1, 4))
    np.testing.assert_array_equal(recording.read(0).pose, np.eye(4))
    with pytest.warns(MosWarning):
        moved = open_recording(path, Options(poses=folder / "poses.txt", frame="lidar"))
    assert moved.poses[0, 2, 3] > 0


def test_mos_takes_it(readers, tmp_path, capsys):
    """Labels in the order of the file."""
    path = readers / "ply" / "argoverse1.ply"
    assert main(["run", str(path), "--out", str(tmp_path), "--bundle", str(BUNDLE), "--postprocess", "none"]) == 0
    assert "one scan, and what moves shows only in several" in " ".join(capsys.readouterr().err.split())
    (label,) = tmp_path.rglob("argoverse1.label")
    assert label.stat().st_size == 4 * 91083


@pytest.mark.parametrize("name", ["a.ply", "a.bag", "a.mcap", "a.db3", "a.pcap"])
def test_an_empty_file(tmp_path, name):
    (tmp_path / name).touch()
    with pytest.raises(SequenceError, match="is empty, a file of 0 bytes"):
        open_recording(tmp_path / name)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3"])
def test_no_bag(tmp_path, name):
    (tmp_path / name).write_bytes(bytes(100))
    with pytest.raises(SequenceError, match="is no bag of ROS"):
        open_recording(tmp_path / name)

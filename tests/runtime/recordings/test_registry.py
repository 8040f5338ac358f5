import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from runtime.errors import SequenceError, SettingError
from runtime.recordings.recording import Indexed, Options
from runtime.recordings.registry import as_given, find_recordings, open_recording, open_recordings
from tests.support import street


def names(path, chosen=()):
    return [one.path.name for one in find_recordings(path, chosen)]


@pytest.mark.parametrize("below", [".", "sequences"])
def test_sequences_are_found_under_a_root(root, below):
    assert names(root / below) == ["03", "11"]
    assert names(root / below, ("11",)) == ["11"]
    assert names(root / below, ("11", "03", "11")) == ["11", "03"]
    with pytest.raises(SequenceError, match="no sequence 12; there are 03, 11"):
        find_recordings(root / below, ("12",))


def test_a_sequence_or_its_velodyne_folder_is_itself_found(folder):
    assert [one.path for one in find_recordings(folder)] == [folder]
    assert [one.path for one in find_recordings(folder / "velodyne")] == [folder]
    with pytest.raises(SequenceError, match="is one recording"):
        find_recordings(folder, ("03",))


def test_nothing_to_find(tmp_path):
    with pytest.raises(SequenceError, match=r"neither sequences/NN/velodyne .* nor a folder of \.bin, \.npy"):
        find_recordings(tmp_path)
    with pytest.raises(SequenceError, match="does not exist"):
        find_recordings(tmp_path / "absent")
    (tmp_path / "file.xyz").write_text("1 2 3")
    with pytest.raises(SequenceError, match="no recording"):
        find_recordings(tmp_path / "file.xyz")


def test_one_recording_is_asked_for(root, folder):
    assert open_recording(folder).name == "03"
    assert open_recording(root, name="11").name == "11"
    with pytest.raises(SequenceError, match="has the sequences 03, 11"):
        open_recording(root)


def test_a_pose_file_is_for_one_recording(root, folder):
    options = Options(poses=folder / "poses.txt")
    assert len(open_recordings(root, ("03",), options)) == 1
    with pytest.raises(SettingError, match="one recording, not for 2"):
        open_recordings(root, (), options)


def test_an_array_beside_the_sequences_does_not_hide_them(root):
    for place in (root, root / "sequences"):
        np.save(place / "notes.npy", np.zeros((5, 3)))
        assert names(place) == ["03", "11"]


def test_a_folder_with_the_name_of_a_scan_is_none(folder, tmp_path):
    (folder / "velodyne" / "x.bin").mkdir()
    assert len(open_recording(folder)) == 6
    (tmp_path / "log" / "000000.bin").mkdir(parents=True)
    with pytest.raises(SequenceError, match="no recording"):
        find_recordings(tmp_path / "log")


def test_names_in_upper_case(folder):
    for file in (folder / "velodyne").iterdir():
        file.rename(file.with_suffix(".BIN"))
    assert open_recording(folder).read(2).data.shape[1] == 4
    shutil.move(folder / "velodyne", folder.parent / "log")
    np.save(folder.parent / "log" / "a.npy", np.zeros((5, 3)))
    (folder.parent / "log" / "a.npy").rename(folder.parent / "log" / "000006.NPY")
    for file in (folder.parent / "log").glob("*.BIN"):
        file.unlink()
    (one,) = find_recordings(folder.parent / "log")
    assert one.open(Options(points_only=True)).read(0).remission is None


def test_a_linked_sequence_has_the_name_of_the_link(folder, tmp_path):
    """Two drives whose folders are called alike, linked into one root: each with its own labels."""
    for number, drive in enumerate(("monday", "friday")):
        shutil.copytree(folder, tmp_path / drive / "lidar")
        (tmp_path / "linked" / "sequences").mkdir(parents=True, exist_ok=True)
        (tmp_path / "linked" / "sequences" / f"{number:02d}").symlink_to(tmp_path / drive / "lidar")
    opened = open_recordings(tmp_path / "linked")
    assert [one.name for one in opened] == ["00", "01"]
    assert open_recording(tmp_path / "linked" / "sequences" / "01").name == "01"


def test_poses_lie_beside_a_linked_velodyne_folder(folder, tmp_path):
    """The scans lie elsewhere, beside other poses."""
    elsewhere = shutil.copytree(folder, tmp_path / "elsewhere" / "55")
    shutil.rmtree(folder / "velodyne")
    (folder / "velodyne").symlink_to(elsewhere / "velodyne")
    street.write_poses(elsewhere / "poses.txt", np.tile(np.eye(4), (6, 1, 1)))
    for given in (folder, folder / "velodyne"):
        recording = open_recording(given)
        assert recording.name == "03"
        assert recording.poses[5, 0, 3] > 1


def test_poses_of_a_linked_sequence_are_looked_for_beside_the_link(folder, tmp_path):
    root = tmp_path / "linked"
    (root / "sequences").mkdir(parents=True)
    (root / "sequences" / "07").symlink_to(folder)
    (root / "poses").mkdir()
    (folder / "poses.txt").rename(root / "poses" / "07.txt")
    assert len(open_recording(root).poses) == 6


def test_the_folder_one_is_in_by_a_link(folder, tmp_path, monkeypatch):
    """A shell that went through a link says so in PWD; the system does not know."""
    (tmp_path / "42").symlink_to(folder)
    monkeypatch.chdir(tmp_path / "42")
    monkeypatch.setenv("PWD", str(tmp_path / "42"))
    assert open_recording(".").name == "42"
    assert open_recording("velodyne").name == "42"
    monkeypatch.setenv("PWD", str(tmp_path))
    assert open_recording(".").name == "03"
    monkeypatch.delenv("PWD")
    assert open_recording(".").name == "03"


def test_up_from_a_link(folder, tmp_path):
    """`link/..` is the folder above the target."""
    (tmp_path / "42").symlink_to(folder)
    assert as_given(tmp_path / "42" / "..") == folder.parent
    assert as_given(folder / ".." / "11") == folder.parent / "11"


class Twin(Indexed):
    """Two files of one stem are two recordings of one name."""

    sensor = poses_from = None
    keys = ()

    def __init__(self, path):
        self.name, self.source = path.stem, str(path)


class TwinReader:
    TITLE = "twins"

    @staticmethod
    def find(path: Path) -> list[Path]:
        return sorted(path.glob("*.twin*"))

    @staticmethod
    def open_at(path: Path, options: Options) -> Twin:
        return Twin(path)


def test_two_recordings_of_one_name_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("runtime.recordings.registry.READERS", (TwinReader,))
    (tmp_path / "a.twin").touch()
    (tmp_path / "b.twin").touch()
    assert [one.name for one in open_recordings(tmp_path)] == ["a", "b"]
    (tmp_path / "a.twins").touch()
    with pytest.raises(SequenceError, match=rf"a\.twin and .*{os.sep}a\.twins have one name"):
        open_recordings(tmp_path)

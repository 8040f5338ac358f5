"""Files and folders are whole or absent, and one file of the product sees to it."""

import os
import stat

import pytest

from runtime.errors import OutputError
from runtime.files import locked, replacing, replacing_folder, scratch, sweep, write_whole
from tests.support.disk import full_disk


def test_a_file_is_written_where_no_folder_was(tmp_path):
    write_whole(tmp_path / "new" / "a", b"one")
    write_whole(str(tmp_path / "new" / "a"), memoryview(b"two"))
    assert (tmp_path / "new" / "a").read_bytes() == b"two"
    assert os.listdir(tmp_path / "new") == ["a"]


def test_who_may_read_it_is_what_the_user_wants(tmp_path):
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "a", b"")
        with replacing_folder(tmp_path / "b"):
            pass
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640
    assert stat.S_IMODE((tmp_path / "b").stat().st_mode) == 0o750


def test_two_writers_of_one_file_do_not_meet(tmp_path):
    with replacing(tmp_path / "a") as first:
        first.write(b"the first")
        write_whole(tmp_path / "a", b"second")
        first.write(b" one")
    assert (tmp_path / "a").read_bytes() == b"the first one"
    assert os.listdir(tmp_path) == ["a"]


def test_links_are_not_followed(tmp_path):
    (tmp_path / "precious").write_bytes(b"precious")
    for name in ("a", ".a.part", f".a.{os.getpid()}.tmp"):
        (tmp_path / name).symlink_to("precious")
    write_whole(tmp_path / "a", b"mine")
    assert (tmp_path / "precious").read_bytes() == b"precious"
    assert (tmp_path / "a").read_bytes() == b"mine"
    assert not (tmp_path / "a").is_symlink()


def test_what_is_no_file_is_not_replaced(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/null")
    for name in ("folder", "pipe", "link"):
        with pytest.raises(OutputError, match="is no file"):
            write_whole(tmp_path / name, b"")
    assert sorted(os.listdir(tmp_path)) == ["folder", "link", "pipe"]


def test_a_full_disk(tmp_path):
    write_whole(tmp_path / "a", b"older")
    with full_disk(1000), pytest.raises(OutputError, match=r"cannot write .*a: File too large"):
        write_whole(tmp_path / "a", bytes(1001))
    assert (tmp_path / "a").read_bytes() == b"older"
    assert os.listdir(tmp_path) == ["a"]


def stop(path):
    with replacing(path) as file:
        file.write(b"half")
        raise KeyboardInterrupt


def test_a_block_that_stops(tmp_path):
    write_whole(tmp_path / "a", b"older")
    with pytest.raises(KeyboardInterrupt):
        stop(tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == b"older"
    assert os.listdir(tmp_path) == ["a"]


def test_a_place_that_is_none(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=rf"cannot write .*b: File exists \({tmp_path}/file\)"):
        write_whole(tmp_path / "file" / "b", b"")
    with pytest.raises(OutputError, match=r"cannot write"), replacing_folder(tmp_path / "file" / "b"):
        pass


def write_folder(path, text):
    with replacing_folder(path) as folder:
        (folder / "inner").mkdir()
        (folder / "inner" / "a").write_text(text)


def test_a_folder_is_replaced_as_one(tmp_path):
    for text in ("one", "two"):
        write_folder(tmp_path / "new" / "folder", text)
        assert (tmp_path / "new" / "folder" / "inner" / "a").read_text() == text
    assert os.listdir(tmp_path / "new") == ["folder"]


def test_a_link_to_a_folder_is_replaced_and_its_target_kept(tmp_path):
    write_folder(tmp_path / "target", "kept")
    (tmp_path / "link").symlink_to("target")
    write_folder(tmp_path / "link", "new")
    assert (tmp_path / "target" / "inner" / "a").read_text() == "kept"
    assert (tmp_path / "link" / "inner" / "a").read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["link", "target"]


def test_a_folder_that_cannot_be_written_leaves_the_older_one(tmp_path, monkeypatch):
    write_folder(tmp_path / "folder", "older")
    with full_disk(2), pytest.raises(OutputError, match=r"cannot write .*folder: File too large"):
        write_folder(tmp_path / "folder", "newer")
    real = os.rename

    def refuse(source, target):
        if str(source).endswith(".part"):
            raise OSError(13, "Permission denied")
        real(source, target)

    monkeypatch.setattr(os, "rename", refuse)
    with pytest.raises(OutputError, match="Permission denied"):
        write_folder(tmp_path / "folder", "newer")
    assert (tmp_path / "folder" / "inner" / "a").read_text() == "older"
    assert os.listdir(tmp_path) == ["folder"]


def test_what_killed_processes_left_is_swept_away_and_nothing_else(tmp_path):
    left = [tmp_path / "a" / ".000001.label.0123abcd.part", tmp_path / ".map.ply.89abcdef.part"]
    kept = [tmp_path / ".part", tmp_path / "a" / "000001.label", tmp_path / "a" / ".notes.part"]
    for path in [*left, *kept]:
        write_whole(path, b"x")
    for name in (".clean.0123abcd.part", ".clean.0123abcd.old"):
        write_whole(tmp_path / name / "000000.ply", b"x")
    sweep(tmp_path)
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == sorted(kept)
    assert not list(tmp_path.glob(".clean*"))


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_temporary_folders_of_killed_processes_are_cleared_away(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for name in ("lidar-mos-dead", "lidar-mos-young", "another"):
        write_whole(tmp_path / name / "file", b"x")
    os.utime(tmp_path / "lidar-mos-dead", (0, 0))
    with scratch() as living:
        os.utime(living, (0, 0))
        with scratch() as other:
            assert {path.name for path in tmp_path.iterdir()} == {
                living.name,
                other.name,
                "lidar-mos-young",
                "another",
            }
    assert {path.name for path in tmp_path.iterdir()} == {"lidar-mos-young", "another"}


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_pieces_share_a_folder_and_keep_others_out(tmp_path):
    with (
        locked(tmp_path, shared=True),
        locked(tmp_path, shared=True),
        pytest.raises(OutputError, match="another run writes there"),
        locked(tmp_path, wait=0),
    ):
        pass
    with locked(tmp_path), pytest.raises(OutputError), locked(tmp_path, shared=True, wait=0):
        pass

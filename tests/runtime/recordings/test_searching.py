"""Where recordings are: below folders, behind patterns."""

import os
from pathlib import Path

import numpy as np
import pytest

from runtime.errors import SequenceError
from runtime.recordings.searching import name_of, search_recordings
from tests.support import street


@pytest.fixture
def logs(tmp_path):
    """Bags by day, two on the floor above, and a sequence; bags are known by their names."""
    for name in ("a.bag", "01/b.mcap", "01/02/c.bag", "01/02/empty.bag"):
        file = tmp_path / "logs" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"" if "empty" in name else b"#")
    street.write_kitti(tmp_path / "logs" / "kitti" / "sequences" / "07", 2, rows=4, columns=20)
    return tmp_path / "logs"


def test_a_folder_is_searched_with_all_below_it(logs):
    os.symlink(logs, logs / "01" / "again", target_is_directory=True)  # leads nowhere new
    found = search_recordings([logs])
    assert sorted(name_of(one) for one in found) == ["07", "a", "b", "c", "empty"]
    assert logs / "kitti" / "sequences" / "07" in found  # and not the folder of scans within
    assert search_recordings([logs, logs / "a.bag", logs / "kitti"]) == found  # each counts once
    assert search_recordings([logs], ("c", "07")) == [logs / "01/02/c.bag", logs / "kitti/sequences/07"]
    with pytest.raises(SequenceError, match="no sequence 99; there are 07, a, b, c, empty"):
        search_recordings([logs], ("99",))


def test_a_pattern_is_one_of_a_shell(logs):
    assert [name_of(one) for one in search_recordings([logs / "01" / "*" / "*.bag"])] == ["c", "empty"]
    assert [name_of(one) for one in search_recordings([logs / "**" / "*.mcap"])] == ["b"]
    with pytest.raises(SequenceError, match="nothing matches"):
        search_recordings([logs, logs / "*.osf"])
    (logs / "x[1].bag").write_bytes(b"#")  # a name that looks like a pattern
    assert [name_of(one) for one in search_recordings([logs / "x[1].bag"])] == ["x[1]"]
    with pytest.raises(SequenceError, match=r"absent\.bag: does not exist"):
        search_recordings([logs, Path("absent.bag")])


def test_what_mos_wrote_is_no_recording(logs):
    place = logs / "labels" / "sequences" / "07"
    (place / "clouds").mkdir(parents=True)
    np.save(place / "clouds" / "000000.npy", np.zeros((5, 4), np.float32))
    assert logs / "labels/sequences/07/clouds" in search_recordings([logs])
    for note in ("run.json", "scans.jsonl"):
        (place / note).write_text("{}")
    assert not [one for one in search_recordings([logs]) if "labels" in one.parts]


def test_two_of_one_name_are_named(logs):
    (logs / "01" / "a.mcap").write_bytes(b"#")
    with pytest.raises(SequenceError, match=r"logs/01/a\.mcap and .*logs/a\.bag have one name") as told:
        search_recordings([logs / "01", logs])
    assert "rename one" in str(told.value)


def test_what_holds_nothing_is_kept_to_be_named(tmp_path, logs):
    (tmp_path / "nothing").mkdir()
    assert search_recordings([tmp_path / "nothing", logs / "a.bag"]) == [tmp_path / "nothing", logs / "a.bag"]

"""A new command is one file, as CONTRIBUTING has it, and one line in `BUILT_IN`."""

import numpy as np

from runtime.commands.main import BUILT_IN, main
from tests.support.paths import TINY


def test_a_new_command_is_one_file(contributed, monkeypatch, capsys, tmp_path):
    contributed("runtime/commands/count.py")
    monkeypatch.setitem(BUILT_IN, "count", "runtime.commands.count:count")
    assert main(["--help"]) == 0
    assert "Count the points of every scan." in capsys.readouterr().out
    assert main(["count", str(TINY / "scans")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 9
    points = np.fromfile(TINY / "scans/sequences/00/velodyne/000003.bin", np.float32).reshape(-1, 4)
    assert lines[3] == f"000003: {len(points)} points"
    assert main(["count", str(tmp_path / "absent")]) == 1
    assert capsys.readouterr().err.startswith("mos: ")
    assert main(["count"]) == 2

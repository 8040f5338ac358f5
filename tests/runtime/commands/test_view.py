"""What `mos view` needs besides the pictures themselves (tests/runtime/pictures)."""

import importlib.util
import sys

import pytest

from runtime.commands.main import main
from runtime.commands.view import check_display
from runtime.errors import SettingError


def test_a_viewer_needs_a_display(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(SettingError, match=r"no display.*rerun a.rrd"):
        check_display("a.rrd")
    if importlib.util.find_spec("rerun"):
        assert main(["view", str(folder), "--out", str(tmp_path / "a.rrd"), "--show"]) == 1
        assert "no display" in capsys.readouterr().err
        assert list(tmp_path.iterdir()) == []
    monkeypatch.setenv("DISPLAY", ":0")
    check_display("a.rrd")

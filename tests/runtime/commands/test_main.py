"""`mos` itself: what it imports, says and returns."""

import os
import re
import subprocess
import sys
import tomllib

import pytest

from runtime.commands.main import main
from tests.support.paths import BUNDLE, ROOT

ENTRY_POINTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["lidar_mos.commands"]
WIDE = {**os.environ, "COLUMNS": "200", "PYTHONPATH": str(ROOT)}


def test_importing_the_command_is_quick():
    """`mos --help` imports every command, and nothing that computes."""
    heavy = {"numpy", "numba", "onnxruntime", "scipy", "torch", "onnx", "rich.progress"}
    loads = f"[Commands.load(EntryPoint(name, value, '')) for name, value in {ENTRY_POINTS}.items()]"
    code = f"""
import sys
import tomllib
from importlib.metadata import EntryPoint
from runtime.commands.main import Commands, main
assert all("cannot be loaded" not in one.help for one in {loads})
main(["--help"])
print({heavy!r} & set(sys.modules))"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=WIDE, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_the_installed_package_is_found_from_any_folder(tmp_path):
    code = "import importlib.metadata as m; m.version('lidar-mos')"
    if subprocess.run([sys.executable, "-I", "-c", code], capture_output=True).returncode:
        pytest.skip("lidar-mos is not installed in this environment")
    code = "from runtime.commands.main import main; main(['--version'])"
    done = subprocess.run([sys.executable, "-I", "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_help_and_version(capsys):
    assert main(["--help"]) == 0
    assert "doctor" in capsys.readouterr().out
    assert main(["run", "--help"]) == 0
    assert "--pose-frame" in capsys.readouterr().out
    assert main(["--version"]) == 0
    assert re.match(r"lidar-mos \d+\.\d+", capsys.readouterr().out)


@pytest.mark.parametrize(
    "arguments",
    [
        ["walk"],
        ["run"],
        ["run", ".", "--threads", "0"],
        ["run", ".", "--limit", "0"],
        ["run", ".", "--pose-frame", "world"],
        ["run", ".", "--postprocess", "best"],
        ["run", ".", "--frobnicate"],
        ["run", ".", "--refine", "far"],
        ["run", ".", "--head-engine", "torch"],
        ["run", ".", "--precision", "int4"],
        ["run", ".", "--session-option", "novalue"],
        ["run", ".", "--on", "spark"],
        ["run", ".", "--on", "ray://"],
        ["run", ".", "--on", "ray", "--jobs", "2"],
        ["run", ".", "--provider", "CUDAExecutionProvider:novalue"],
        ["run", "{folder}", "--pose-frame", "lidar", "--calib", "{folder}/calib.txt"],
        ["run", "{folder}", "--allow-fallback"],
        ["run", "{folder}", "--bundle", "{bundle}", "--postprocess", "knn", "--refine", "all"],
        ["run", "{folder}", "--bundle", "{bundle}", "--postprocess", "none", "--head-engine", "numba"],
        ["doctor", "{folder}", "--pose-frame", "lidar", "--calib", "{folder}/calib.txt"],
        ["view", "{folder}", "--pose-frame", "lidar", "--calib", "{folder}/calib.txt"],
        ["view", "{folder}", "--count", "3"],
        ["view", "{folder}", "--count", "3", "--out", "a.PNG"],
        ["view", "{folder}", "--show"],
        ["view", "{folder}", "--predictions", "there", "--threads", "2"],
        ["view", "{folder}", "--predictions", "there", "--bundle", "{bundle}"],
        ["eval", "there"],
        ["eval", "there", "true", "--zip", "a.zip", "--out", "a.json"],
    ],
)
def test_wrong_usage_is_2(arguments, folder, tmp_path, capsys, monkeypatch):
    """Also where an option would be ignored beside another."""
    monkeypatch.chdir(tmp_path)
    assert main([argument.format(folder=folder, bundle=BUNDLE) for argument in arguments]) == 2
    assert capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "absent"], "does not exist"),
        (["run", "{folder}", "--poses", "absent.txt"], "absent.txt does not exist"),
        (["run", "{folder}", "--calib", "absent.txt"], "absent.txt does not exist"),
        (["run", "{folder}", "--bundle", "absent"], "absent"),
        (["info", "absent"], "absent"),
        (["doctor", "absent"], "does not exist"),
        (["doctor", "{folder}", "--bundle", "absent"], "absent"),
    ],
)
def test_errors_are_one_line_without_a_traceback(folder, tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main([argument.format(folder=folder) for argument in arguments]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("mos: ")
    assert shown.err.count("\n") == 1
    assert message in shown.err

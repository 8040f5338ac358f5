"""Errors, warnings and exit codes, the same for every command and for `python -m ...`."""

import subprocess
import sys
import warnings

import pytest

from export.to_onnx import export
from mos_model.train import train
from runtime.commands.handler import run_alone
from runtime.errors import MosWarning, OutputError, SettingError
from tests.support.paths import ROOT


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (SettingError("no good; name another (`out`)"), 1, "tool: no good; name another (--out)\n"),
        (OutputError("disk full"), 1, "tool: disk full\n"),
        (PermissionError(13, "Permission denied", "x"), 1, "tool: [Errno 13] Permission denied: 'x'\n"),
        (KeyboardInterrupt(), 130, "mos: interrupted\n"),
        (SystemError("returned a result"), None, ""),
    ],
)
def test_exit_codes(error, code, said, capsys):
    def work(out: str = "x") -> None:
        raise error

    if code is None:
        with pytest.raises(SystemError):
            run_alone(work, "tool", [])
    else:
        assert run_alone(work, "tool", []) == code
    assert capsys.readouterr().err == said
    assert run_alone(work, "tool", ["--no-such"]) == 2


def test_an_interrupt_that_numba_wraps(capsys):
    def work() -> None:
        raise SystemError("returned a result") from KeyboardInterrupt()

    assert run_alone(work, "tool", []) == 130


def test_warnings_are_lines_in_the_words_of_the_command(capsys):
    def work(limit: int = 3) -> None:
        warnings.warn("that is much (`limit=2`)", MosWarning, stacklevel=1)

    assert run_alone(work, "tool", []) == 0
    assert capsys.readouterr().err == "tool: warning: that is much (--limit 2)\n"


@pytest.mark.parametrize(("command", "packages"), [(train, ["torch"]), (export, ["torch", "onnx"])])
def test_a_missing_package_is_named_with_its_extra(command, packages, monkeypatch, tmp_path, capsys):
    for package in packages:
        monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.chdir(tmp_path)
    name = command.__name__
    assert run_alone(command, f"mos {name}", ["--out", "x"]) == 1
    why = f"mos: mos {name} needs {' and '.join(packages)}, not installed here: pip install 'lidar-mos[{name}]'\n"
    assert capsys.readouterr().err == why
    assert run_alone(command, f"mos {name}", ["--help"]) == 0
    assert list(tmp_path.iterdir()) == []


PROGRAMS = [
    file
    for room in ("runtime", "mos_model", "export", "bench")
    for file in (ROOT / room).rglob("*.py")
    if "__main__" in file.read_text() and file != ROOT / "runtime" / "commands" / "start.py"
]


@pytest.mark.parametrize("file", PROGRAMS, ids=lambda file: file.stem)
def test_every_program_has_this_handler(file):
    """A failure of a program that lacks it is a traceback."""
    assert "typer.run" not in file.read_text()
    assert "run_alone(" in file.read_text()


def test_a_reader_that_goes_away_is_no_error():
    code = "from runtime.commands.main import main; import sys; sys.exit(main(['info']))"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
    ) as shown:
        shown.stdout.close()
        assert b"Traceback" not in shown.stderr.read()
    assert shown.returncode in (0, 1)

"""Commands of other packages: one file and one entry point each; a broken one is its own trouble."""

import os
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint, entry_points

import pytest

from runtime.commands.main import BUILT_IN, GROUP, Commands
from tests.support.paths import ROOT

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
ENTRY_POINTS = PYPROJECT["project"]["entry-points"][GROUP]

DUMMY = '''"""A command that somebody else wrote."""


def greet(name: str, times: int = 1) -> None:
    """Say hello."""
    print(f"hello {name}! " * times)
'''


@pytest.fixture
def mos(tmp_path):
    """Runs `mos` with what is in `tmp_path` installed."""

    def run(*arguments):
        environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}", "COLUMNS": "200"}
        command = [sys.executable, "-m", "runtime.commands.start", *arguments]
        return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)

    return run


def install(folder, *lines):
    info = folder / "dummy-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: dummy\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join((f"[{GROUP}]", *lines)) + "\n")


def test_a_command_is_one_file_and_one_line(mos, tmp_path):
    (tmp_path / "dummy.py").write_text(DUMMY)
    install(tmp_path, "greet = dummy:greet")
    done = mos("greet", "you", "--times", "2")
    assert (done.returncode, done.stdout.strip()) == (0, "hello you! hello you!")
    assert "Say hello." in mos("--help").stdout
    assert mos("greet").returncode == 2


@pytest.mark.parametrize(
    ("line", "module", "why"),
    [
        ("broken = absent_package:run", "", "No module named 'absent_package'"),
        ("broken = dummy:run", "", "has no attribute 'run'"),
        ("broken = dummy:run", "run = 3", "TypeError"),
        ("broken = dummy:run", "import sys; sys.exit(3)", "SystemExit: 3"),
        ("broken = dummy:run", "def run(x: 'nonsense'): pass", "nonsense"),
    ],
)
def test_a_broken_command_leaves_the_others_alone(mos, tmp_path, line, module, why):
    (tmp_path / "dummy.py").write_text(module)
    install(tmp_path, line, "run = dummy:run")
    done = mos("broken", "anything", "--at", "all")
    assert done.returncode == 1
    assert done.stderr.startswith("mos: broken cannot be loaded from ")
    assert why in done.stderr
    shown = mos("--help")
    assert shown.returncode == 0
    assert "cannot be loaded" in shown.stdout
    assert mos("run", "--help").stdout.count("--pose-frame") == 1  # ours, not the one that has taken its name


def test_commands_of_this_checkout_load():
    for name, value in ENTRY_POINTS.items():
        command = Commands.load(EntryPoint(name, value, GROUP))
        assert command.help, name
        assert "cannot be loaded" not in command.help


def test_commands_of_this_checkout_are_installed(mos):
    if {entry.name: entry.value for entry in entry_points(group=GROUP)} != ENTRY_POINTS:
        pytest.skip("lidar-mos is not installed here, or as it was before: pip install -e .")
    assert set(Commands()) == {*BUILT_IN, *ENTRY_POINTS}
    shown = mos("--help").stdout
    assert "cannot be loaded" not in shown
    places = [shown.index(f"│ {name} ") for name in Commands()]
    assert places == sorted(places)

"""Words and characters that reach the terminal."""

import ast
import re
import tomllib
from importlib.metadata import EntryPoint

import pytest

from runtime.commands.main import BUILT_IN, Commands, main
from runtime.commands.output import HINT, SPEAKER, Speaker, Terminal, printable, say, worded
from tests.support import street
from tests.support.paths import BUNDLE, ROOT


@pytest.fixture
def speaker():
    before = SPEAKER.set(Speaker("mos", {"frame": "--pose-frame", "out": "--out", "again": "--again"}))
    yield
    SPEAKER.reset(before)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("name a folder (`out`)", "name a folder (--out)"),
        ("say so (`frame='lidar'`), or not", "say so (--pose-frame lidar), or not"),
        ("use `frame='lidar'`", "use --pose-frame lidar"),
        ("once more (`again=True`)", "once more (--again)"),
        ("the first ones (`limit=5`) are enough", "the first ones are enough"),
        ("use `limit`", "use `limit`"),
        ("`mos run` goes on (twice)", "`mos run` goes on (twice)"),
    ],
)
def test_hints_are_options_of_the_running_command(speaker, text, shown):
    assert worded(text) == shown


def test_without_a_command_hints_name_arguments():
    assert worded("use `frame='lidar'`") == "use `frame='lidar'`"


@pytest.mark.parametrize("text", ["plain", "ünïcode 東京", "two\nlines", "a [bold]b[/bold] :smile: {c}"])
def test_text_stays_as_it_is(text, capsys):
    assert printable(text) == text
    say(text)
    Terminal().print(text)
    shown = capsys.readouterr()
    assert shown.err == f"mos: {text}\n"
    assert shown.out == f"{text}\n"


@pytest.mark.parametrize("evil", ["\x1b[31m", "\x1b]0;title\x07", "\r", "\x08", "\x9b2J", "\u202e", "\udcff", "\x7f"])
def test_control_characters_do_not_reach_the_terminal(evil, capsys):
    assert printable(evil).isprintable()
    say(f"a{evil}b")
    Terminal().print(f"a{evil}b")
    Terminal(stderr=True).print(f"a{evil}b")
    shown = capsys.readouterr()
    for text in (shown.out, shown.err):
        assert text.replace("\n", "").isprintable()


def test_names_of_folders_cannot_write_to_the_terminal(tmp_path, capsys):
    folder = street.write_kitti(tmp_path / "evil\x1b[2J\x9b[1m" / "07\x1b[31m", 2, rows=8, columns=60)
    assert main(["run", str(folder), "--out", str(tmp_path / "out\x1bc"), "--bundle", str(BUNDLE)]) == 0
    main(["doctor", str(folder), "--bundle", str(BUNDLE)])
    main(["run", str(folder.parent / "absent\x1bc")])
    main(["eval", str(tmp_path / "out\x1bc"), str(folder)])
    shown = capsys.readouterr()
    for text in (shown.out, shown.err):
        assert "\\x1b" in text
        assert text.replace("\n", "").isprintable(), text


PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
ENTRY_POINTS = PYPROJECT["project"]["entry-points"]["lidar_mos.commands"]
COMMANDS = {value.partition(":")[0].replace(".", "/") + ".py" for value in (*BUILT_IN.values(), *ENTRY_POINTS.values())}
FILES = (file.relative_to(ROOT) for room in ("runtime", "mos_model", "export") for file in (ROOT / room).rglob("*.py"))
LIBRARY = [file for file in FILES if "commands" not in file.parts and str(file) not in COMMANDS]


def texts(path):
    """Every string of a source file but docstrings."""
    tree = ast.parse((ROOT / path).read_text())
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            found.append("".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            found.append(node.value)
    return found


def test_libraries_name_no_options():
    """They do not know which command calls them; whole commands such as `mos export --out X` are fine."""
    named = {}
    for path in LIBRARY:
        for text in texts(path):
            if found := re.findall(r"--[a-z][a-z-]*", re.sub(r"`mos [^`]*`", "", text)):
                named.setdefault(str(path), []).extend(found)
    assert not named


@pytest.mark.skipif(not LIBRARY, reason="there is no source here")
def test_hints_are_arguments_of_some_command():
    known = {
        option.name
        for name in ENTRY_POINTS.keys() | BUILT_IN.keys()
        for option in Commands.load(EntryPoint(name, {**BUILT_IN, **ENTRY_POINTS}[name], "")).params
    }
    hints = {hint["name"] for path in LIBRARY for text in texts(path) for hint in HINT.finditer(text)}
    assert hints
    assert hints <= known

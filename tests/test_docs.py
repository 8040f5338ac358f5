"""What the Markdown files say is so: links lead somewhere, files, commands and options exist, numbers are measured."""

import importlib.util
import json
import re
import shlex
from pathlib import Path

import pytest

from runtime.commands.main import Commands
from tests.support.markdown import FOLDERS, blocks, documents
from tests.support.paths import ROOT


def name(file):
    return str(file.relative_to(ROOT))


FILES = [name(path) for folder in (*FOLDERS, "tests") for path in (ROOT / folder).rglob("*")]
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?")


def every(test):
    return pytest.mark.parametrize("file", documents(), ids=name)(test)


@every
def test_links_lead_somewhere(file):
    for target in re.findall(r"\]\(([^)#\s]+)", file.read_text()):
        assert target.startswith("https://") or (file.parent / target).exists(), target


@every
def test_files_that_are_named_are_there(file):
    made = [block.code.splitlines()[0].removeprefix("# ") for block in blocks(file, "python")]  # by who reads it
    for path in re.findall(r"`[./]*([\w/]+\.(?:py|md))`", file.read_text()):
        assert any(f"/{one}".endswith(f"/{path}") for one in (*FILES, *made)), path


def commands(file):
    """The words of every command in a file, in blocks and within the text."""
    text = "\n".join(block.code for block in blocks(file, "bash"))
    text += "\n" + "\n".join(re.findall(r"`((?:mos|python) [^`]+)`", file.read_text()))
    for line in text.splitlines():
        for part in re.split("&&|;", line):
            yield shlex.split(part, comments=True)


@every
def test_commands_and_their_options_exist(file):
    known = Commands()
    for words in commands(file):
        program = Path(words[0]).name if words else ""
        given = {word.partition("=")[0] for word in words[1:] if word.startswith("--")}
        if program == "mos" and not words[1].startswith("-"):
            assert words[1] in known, words
            assert given <= {option for one in known[words[1]].params for option in one.opts} | {"--help"}, words
        elif (
            program == "python"
            and words[1] == "-m"
            and words[2].split(".")[0] in ("bench", "export", "mos_model", "tests")
        ):
            source = Path(importlib.util.find_spec(words[2]).origin).read_text()
            assert all(re.search(rf"\b{option.lstrip('-').replace('-', '_')}_?\b", source) for option in given), words
        elif program == "python" and words[1].endswith(".py"):
            assert (ROOT / words[1]).is_file(), words


def values(data):
    """All numbers of a JSON file, and a hundred times each (%)."""
    if isinstance(data, dict | list):
        inner = data.values() if isinstance(data, dict) else data
        return [number for one in inner for number in values(one)]
    try:
        return [float(data), 100 * float(data)]
    except (TypeError, ValueError):
        return []


def tables_with_results():
    """The rows of every table that stands in one section with links to results, and these."""
    for file in documents():
        for section in re.split(r"^## ", file.read_text(), flags=re.MULTILINE):
            results = [file.parent / target for target in re.findall(r"\]\(([^)]+\.json)\)", section)]
            tables = re.findall(r"^\|[^\n]*\n\| ?-[^\n]*\n((?:\|[^\n]*\n)+)", section, re.MULTILINE)
            if results and tables:
                rows = [row.strip("|") for table in tables for row in table.splitlines()]
                yield pytest.param(rows, results, id=f"{name(file)}: {section.splitlines()[0]}")


@pytest.mark.parametrize(("rows", "results"), [*tables_with_results()])
def test_numbers_of_tables_are_those_of_the_results_beside_them(rows, results):
    measured = values([json.loads(result.read_text()) for result in results])
    for row in rows:
        _, _, cells = row.partition("|")
        for number in NUMBER.findall(cells):
            value, step = float(number.replace(",", "")), 10.0 ** -len(number.partition(".")[2])
            assert any(abs(one - value) <= 0.5001 * step for one in measured), f"{number} of {row}"


def test_modules_that_the_changelog_names_are_there():
    rows = re.findall(r"^ +\| `(.+) \| (.+) \|$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert len(rows) > 10
    for _, new in rows:
        for module in re.findall(r"`((?:runtime|mos_model|export)\.[\w.]+)`", new):
            assert importlib.util.find_spec(module), module


def test_the_readmes_list_every_command_and_benchmark():
    assert set(Commands()) <= set(re.findall(r"^\| `mos (\w+)", (ROOT / "README.md").read_text(), re.MULTILINE))
    benchmarks = {path.stem for path in (ROOT / "bench").glob("*.py") if "run_alone(bench" in path.read_text()}
    listed = re.findall(r"^\| `python -m bench.(\w+)", (ROOT / "bench" / "README.md").read_text(), re.MULTILINE)
    assert set(listed) == benchmarks

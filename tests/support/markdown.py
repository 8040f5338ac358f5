"""What the Markdown files of this repository hold."""

import re
from pathlib import Path
from typing import NamedTuple

from tests.support.paths import ROOT

FOLDERS = ("runtime", "mos_model", "export", "bench", "models")
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """A block of code."""

    language: str
    line: int  # of its first line in the file, from 1
    code: str


def documents() -> list[Path]:
    """All of them."""
    return sorted([*ROOT.glob("*.md"), *(file for folder in FOLDERS for file in (ROOT / folder).rglob("*.md"))])


def blocks(file: Path, language: str) -> list[Block]:
    """The blocks of one language."""
    text = file.read_text(encoding="utf-8")
    found = [Block(one[1], text.count("\n", 0, one.start(2)) + 1, one[2]) for one in _BLOCK.finditer(text)]
    return [block for block in found if block.language == language]


def run(file: Path, block: Block, names: dict[str, object]) -> None:
    """Run a block of Python with `names`, which gain what it defines; tracebacks show the lines of the file."""
    exec(compile("\n" * (block.line - 1) + block.code, str(file), "exec"), names)

"""What reaches the terminal: messages in the words of the running command, names without control characters."""

import re
from collections.abc import Iterable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

# A library knows no commands. It names an argument in backticks: `limit=5`, or (`limit=5`) where the words before it do
# for a command that has no such option.
HINT = re.compile(r"(?P<aside> \()?`(?P<name>\w+)(?:=(?P<value>[^`]*))?`(?(aside)\))")


@dataclass(frozen=True)
class Speaker:
    """The command that runs."""

    name: str = "mos"  # before each of its lines on stderr
    options: Mapping[str, str] = field(default_factory=dict)  # by the argument's name: {"frame": "--pose-frame"}


SPEAKER: ContextVar[Speaker] = ContextVar("SPEAKER")
NOBODY = Speaker()


def worded(text: str) -> str:
    """A library's text with the options of the running command in place of the arguments that it names."""
    options = SPEAKER.get(NOBODY).options

    def option(hint: re.Match[str]) -> str:
        if hint["name"] not in options:
            return "" if hint["aside"] and options else hint[0]
        value = (hint["value"] or "").strip("'")
        words = options[hint["name"]] + (f" {value}" if value not in ("", "True") else "")
        return f" ({words})" if hint["aside"] else words

    return HINT.sub(option, text)


def printable(text: str) -> str:
    """Text as it may be shown: no name of a file moves the cursor, changes colours or is refused by the terminal."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)


def say(text: str) -> None:
    """Lines on stderr, beside the results."""
    typer.echo(printable(f"{SPEAKER.get(NOBODY).name}: {worded(text)}"), err=True)


class Terminal(Console):
    """Text as it is given: no markup, no emoji, no control characters."""

    def __init__(self, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else printable(text), style, control)


def show_line(text: str, style: str | None = None) -> None:
    """A line on stdout, never broken, so that it can be copied."""
    Terminal().print(text, style=style, soft_wrap=True)


def show_rows(rows: Iterable[tuple[str | Text, ...]]) -> None:
    """A table without lines on stdout."""
    table = Table(box=None, show_header=False, pad_edge=False)
    for row in rows:
        table.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in row))
    Terminal().print(table)


def show_facts(facts: Mapping[str, str]) -> None:
    """A table of names and what is so called, on stdout."""
    show_rows((Text(name, style="bold"), text) for name, text in facts.items())

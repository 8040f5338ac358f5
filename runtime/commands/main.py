"""The command `mos`: finds its commands, each in a file of its own, and runs the one that was called."""

from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any

import typer

from runtime import __version__
from runtime.commands import handler
from runtime.errors import MosError

GROUP = "lidar_mos.commands"  # of entry points by which other packages add commands
BUILT_IN = {  # as entry points have it; in the order of `mos --help`
    "run": "runtime.commands.run:run",
    "live": "runtime.commands.live:live",
    "clean": "runtime.commands.clean:clean",
    "view": "runtime.commands.view:view",
    "doctor": "runtime.commands.doctor:doctor",
    "eval": "runtime.commands.evaluate:evaluate",
    "info": "runtime.commands.info:info",
}

app = typer.Typer(
    help="Moving-object segmentation of LiDAR scans on a plain CPU.", no_args_is_help=True, **handler.PLAIN
)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"lidar-mos {__version__}")
        raise typer.Exit


class Commands(Mapping[str, Any]):
    """All commands by their names: those of this package, then those of others. Each is imported when it is asked for:
    `mos run` neither waits for the others nor fails with them."""

    def __init__(self) -> None:
        self._built_in = {name: EntryPoint(name, value, GROUP) for name, value in BUILT_IN.items()}

    def __getitem__(self, name: str) -> Any:
        return self.load(self._built_in.get(name) or self._others()[name])

    def __iter__(self) -> Iterator[str]:
        yield from self._built_in
        yield from sorted(self._others().keys() - self._built_in.keys())

    def __len__(self) -> int:
        return sum(1 for _ in self)

    @staticmethod
    def load(entry: EntryPoint) -> Any:
        """The command of an entry point; where that fails, a command that says so."""
        try:
            return handler.command(entry.name, entry.load())
        except (Exception, SystemExit) as error:  # whatever another package does when it is imported
            why = f"cannot be loaded from {entry.value}: {type(error).__name__}: {error}"
            anything = {"allow_extra_args": True, "ignore_unknown_options": True}
            return handler.command(entry.name, _failing(f"{entry.name} {why}"), help=why, context_settings=anything)

    def _others(self) -> dict[str, EntryPoint]:
        return {entry.name: entry for entry in entry_points(group=GROUP)}


def _failing(text: str) -> Callable[[], None]:
    def fail() -> None:
        raise MosError(text)

    return fail


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `mos`. 0: done, 1: failed (stderr says why), 2: wrong usage, 130: interrupted."""
    mos: Any = typer.main.get_command(app)
    mos.commands = Commands()
    return handler.exit_code(mos, "mos", arguments)

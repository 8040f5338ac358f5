"""What every command does with errors, warnings and interrupts: of `mos` and of `python -m ...` alike."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import typer
from typer.core import TyperCommand

from runtime.commands.output import SPEAKER, Speaker, say
from runtime.commands.terminal_voice import TerminalVoice
from runtime.errors import MissingPackageError, MosError, is_interrupt
from runtime.fleet.voice import heard

PLAIN: dict[str, Any] = {"add_completion": False, "pretty_exceptions_enable": False}  # of every typer app


class Command(TyperCommand):
    """A command whose errors and warnings are lines on stderr. It ends with 0: done, 1: failed, 2: wrong usage, or
    130: interrupted."""

    def invoke(self, ctx: Any) -> Any:
        name = ctx.command_path.partition(" ")[0]
        before = SPEAKER.set(Speaker(name, {option.name: option.opts[0] for option in self.params if option.name}))
        with heard(TerminalVoice()):
            try:
                return super().invoke(ctx)
            except BrokenPipeError:  # nobody reads any more, as with `| head`: typer ends without a word
                raise
            except (MosError, OSError) as error:  # OSError: a folder that may not be read
                say(str(error))
                raise typer.Exit(1) from None
            finally:
                SPEAKER.reset(before)


def command(name: str, function: Callable[..., None], **settings: Any) -> Any:
    """The command of a function whose arguments are annotated as typer has it."""
    app = typer.Typer(**PLAIN)
    app.command(name, cls=Command, **settings)(function)
    return typer.main.get_command(app)


def run_alone(function: Callable[..., None], name: str, arguments: list[str] | None = None) -> int:
    """Run a function as a command of its own, called `name`; its exit code."""
    return exit_code(command(name, function), name, arguments)


def exit_code(command: Any, name: str, arguments: list[str] | None = None) -> int:
    """Run a command; the code with which the process is to end."""
    try:
        command(arguments, prog_name=name)
    except SystemExit as done:  # how typer ends
        if is_interrupt(done):
            say("interrupted")
        return done.code if isinstance(done.code, int) else 0
    except Exception as error:
        if not is_interrupt(error):
            raise
        say("interrupted")
        return 130
    return 0


def need_extra(extra: str, *packages: str) -> None:
    """Raises MissingPackageError where packages that this extra brings are not installed."""
    if missing := [package for package in packages if find_spec(package) is None]:
        raise MissingPackageError(
            f"mos {extra} needs {' and '.join(missing)}, not installed here: pip install 'lidar-mos[{extra}]'"
        )

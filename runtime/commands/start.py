"""Where the script `mos` begins: with as little as can be, for an interrupt is no error from the first moment on."""

from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """What `runtime.commands.main` does; 130 where the user ends it while that is loaded."""
    try:
        from runtime.commands.main import main as run

        return run(None if arguments is None else list(arguments))
    except KeyboardInterrupt:
        return 130

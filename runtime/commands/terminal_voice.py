"""The `Voice` of a command that does one thing after the other."""

from contextlib import AbstractContextManager

from runtime.commands.output import say, show_line
from runtime.fleet.voice import Progress


class TerminalVoice:
    """Lines on stderr and stdout, and a bar for each step."""

    def say(self, text: str) -> None:
        """See `Voice`."""
        say(text)

    def warn(self, text: str) -> None:
        """See `Voice`."""
        say(f"warning: {text}")

    def show(self, text: str) -> None:
        """See `Voice`."""
        show_line(text)

    def counted(self, what: str, labels: bool = False) -> AbstractContextManager[Progress]:
        """See `Voice`."""
        from runtime.commands.progress import counted

        return counted(what)

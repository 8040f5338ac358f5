"""Who is told what happens with a recording: a terminal, or the process that gave the work."""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, TextIO

from runtime.errors import MosWarning

Progress = Callable[[int, int | None], object]  # done, and of how many; None: that is not known
TOLD = ("lidar_mos.recordings", "lidar_mos.sensors")  # loggers of what users want to know


class Voice(Protocol):
    """Texts name arguments in backticks, as those of errors do."""

    def say(self, text: str) -> None:
        """What was chosen."""

    def warn(self, text: str) -> None:
        """What may make labels wrong."""

    def show(self, text: str) -> None:
        """What was written."""

    def counted(self, what: str, labels: bool = False) -> AbstractContextManager[Progress]:
        """Within, steps of work are counted; labels: each is a scan that has its label."""
        ...


@contextmanager
def heard(voice: Voice) -> Iterator[None]:
    """Within, warnings and what our loggers are told go to this voice alone; a warning of before counts as new."""

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        ours = issubclass(category, MosWarning)  # where in the code it is says nothing to a user
        voice.warn(str(message) if ours else warnings.formatwarning(message, category, filename, lineno, line).rstrip())

    with warnings.catch_warnings(), _said(voice):
        warnings.simplefilter("default", MosWarning)
        warnings.showwarning = show
        yield


class _Sayer(logging.Handler):
    """Says what loggers are told: of some everything, of the others what is a warning."""

    def __init__(self, voice: Voice) -> None:
        super().__init__(logging.INFO)
        self._voice = voice

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING or record.name.startswith(TOLD):
            self._voice.say(record.getMessage())


@contextmanager
def _said(voice: Voice) -> Iterator[None]:
    """Within, our loggers have this voice, and none of before."""
    log, told = logging.getLogger("lidar_mos"), [logging.getLogger(name) for name in TOLD]
    handlers, levels = log.handlers, [one.level for one in told]
    log.handlers = [*(one for one in handlers if not isinstance(one, _Sayer)), _Sayer(voice)]
    for one in told:
        one.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.handlers = handlers
        for one, level in zip(told, levels, strict=True):
            one.setLevel(level)

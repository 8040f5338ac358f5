"""`mos` in processes of their own, which begin where everything is loaded, and are struck at a moment of their work."""

import contextlib
import os
import signal
import sys
import threading
from multiprocessing import get_context
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, NamedTuple

from runtime.commands.start import main
from tests.support.disk import full_disk

EVENTS = (
    "open",
    "os.rename",
    "os.remove",
    "os.mkdir",
    "os.truncate",
    "fcntl.flock",
)  # on the way of a file to its place
UNCAUGHT = 99  # the code of a process that ends by an error that no command catches, in whatever thread
LOADED = "tests.support.loaded"  # where these processes begin


class Strike(NamedTuple):
    """A signal that a process sends to itself: before its so many-th event in a folder, or after some s."""

    number: int
    event: int = 0
    folder: Path | None = None
    seconds: float = 0.0


def start(arguments: list[str], strike: Strike | None = None, room: int | None = None) -> ForkServerProcess:
    """`mos` with these arguments; room: bytes, beyond which no file of it can be."""
    context = get_context("forkserver")
    context.set_forkserver_preload([LOADED])
    process = context.Process(target=_work, args=(arguments, strike, room))
    process.start()
    return process


def code_of(process: ForkServerProcess) -> int:
    """The code with which it ends, -N: by signal number N."""
    process.join()
    code = process.exitcode
    assert code is not None
    return code


def _work(arguments: list[str], strike: Strike | None, room: int | None) -> None:
    silent = open(os.devnull, "w")  # noqa: SIM115 - which is never full
    os.dup2(silent.fileno(), 1)
    os.dup2(silent.fileno(), 2)
    sys.stdout = sys.stderr = silent
    threading.excepthook = lambda _: os._exit(UNCAUGHT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    code = UNCAUGHT
    try:
        if strike:
            _struck(strike)
        with full_disk(room) if room is not None else contextlib.nullcontext():
            code = main(arguments)
    finally:
        os._exit(code)


def _struck(strike: Strike) -> None:
    if strike.folder is None:
        timer = threading.Timer(strike.seconds, os.kill, (os.getpid(), strike.number))
        timer.daemon = True
        return timer.start()
    left = [strike.event]

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if event in EVENTS and arguments and str(arguments[0]).startswith(str(strike.folder)):
            left[0] -= 1
            if left[0] == -1:
                os.kill(os.getpid(), strike.number)

    sys.addaudithook(watch)

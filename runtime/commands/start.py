"""Where the script `mos` begins: with as little as can be, for an interrupt is no error from the first moment on."""

import signal
import sys
from collections.abc import Sequence
from types import FrameType

# What cannot be cut in two: half an import is an error of its own, an error in `__del__` is printed and lost, and in
# Numba's libraries a lock stays closed, for which the next call waits for ever.
WHOLE = ("<frozen importlib", "/numba/", "/llvmlite/")
MOMENT = 0.01  # s after which it is tried again


def main(arguments: Sequence[str] | None = None) -> int:
    """What `runtime.commands.main` does; interrupted at whatever moment, it says so and the code is 130."""
    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else the user wants none, as by `nohup`
    try:
        if heeded and hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, _interrupt)
            signal.signal(signal.SIGINT, _interrupt)
        from runtime.commands.main import main as run

        return run(None if arguments is None else list(arguments))
    except KeyboardInterrupt:
        sys.stderr.write("mos: interrupted\n")
        return 130
    finally:
        if heeded:
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # all is done: what still ends may be ended at once


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, at once or as soon as nothing is cut in two."""
    while frame is not None and frame.f_code is not main.__code__:
        code = frame.f_code
        if code.co_name == "__del__" or any(part in code.co_filename for part in WHOLE):
            signal.setitimer(signal.ITIMER_REAL, MOMENT)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())

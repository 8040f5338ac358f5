"""Which kernel Numba is compiling just now."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core import event

OURS = ("runtime.", "mos_model.")  # modules; Numba compiles parts of its own besides


@contextmanager
def compiling(on_kernel: Callable[[str], object]) -> Iterator[None]:
    """Within, call `on_kernel("module.function")` when a kernel begins to be compiled, not when it comes from disk."""

    class Listener(event.Listener):
        def on_start(self, event: event.Event) -> None:
            function = event.data["dispatcher"].py_func
            if function.__module__.startswith(OURS):
                on_kernel(f"{function.__module__.rpartition('.')[2]}.{function.__name__}")

        def on_end(self, event: event.Event) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield

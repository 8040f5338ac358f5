"""Which kernel Numba is compiling just now."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from runtime.compute.internals import on_compile
from runtime.compute.origin import OURS


def compiling(on_kernel: Callable[[str], object]) -> AbstractContextManager[Any]:
    """Within, call `on_kernel("module.function")` when a kernel begins to be compiled, not when it comes from disk."""

    def tell(function: Any) -> None:
        if function.__module__.startswith(OURS):  # Numba compiles parts of its own besides
            on_kernel(f"{function.__module__.rpartition('.')[2]}.{function.__name__}")

    return on_compile(tell)

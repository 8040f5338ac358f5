"""The one compile policy of all Numba kernels.

Kernels release the GIL and are single-threaded; `runtime.compute.workers.Workers` runs them side by side. So Numba's
threading layers, with their process-wide settings and their trouble with forks and concurrent callers, are never
used. Compiled code is kept on disk (`runtime.compute.kernel_cache`).
"""

import functools
from collections.abc import Callable
from typing import Any, NoReturn

import llvmlite.ir
import numba
import numba.extending

from runtime.compute.internals import compile_by
from runtime.compute.kernel_cache import is_kept, keep
from runtime.compute.undisturbed import undisturbed
from runtime.errors import SettingError

Function = Callable[..., Any]  # Numba finds out what the arguments are

# For functions that generate their code themselves, without types that a checker could see.
compiled: Any = numba.extending.intrinsic
types: Any = numba.types
ir: Any = llvmlite.ir

# Sums may be contracted and reordered; NaN and infinity keep their meaning (kernels test for them).
FASTMATH = {"contract", "reassoc", "nsz"}


def kernel(function: Function) -> Function:
    """Compile a kernel with IEEE arithmetic."""
    return _compile(function)


def fast_kernel(function: Function) -> Function:
    """Compile a kernel whose sums may be contracted and reordered (so that loops vectorise)."""
    return _compile(function, fastmath=FASTMATH)


def inlined(function: Function) -> Function:
    """Compile a helper that is inlined into the kernels of its own file."""
    return _compile(function, fastmath=FASTMATH, inline="always")


def is_cached(kernel: Any) -> bool:
    """Whether compiled code of a kernel lies on disk (or in this process) already, or never will."""
    return bool(getattr(kernel, "signatures", True)) or is_kept(kernel)


def _compile(function: Function, **options: Any) -> Function:
    if getattr(numba.config, "DISABLE_JIT", 0):
        return _refusing(function)
    compiled: Function = numba.njit(nogil=True, error_model="numpy", **options)(function)
    keep(compiled)
    compile_by(undisturbed, compiled)
    return compiled


def _refusing(function: Function) -> Function:
    """In place of a kernel that Numba may not compile. As Python it would wrap, round and divide otherwise."""

    @functools.wraps(function)
    def refuse(*arguments: Any) -> NoReturn:
        raise SettingError(
            f"{function.__name__} of {function.__module__} runs compiled only, and NUMBA_DISABLE_JIT=1 (or DISABLE_JIT "
            "in .numba_config.yaml) keeps Numba from compiling. Unset it"
        )

    return refuse

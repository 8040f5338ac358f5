"""The one compile policy of all Numba kernels.

Kernels release the GIL and are single-threaded; `runtime.compute.workers.Workers` runs them side by side. So Numba's
threading layers, with their process-wide settings and their trouble with forks and concurrent callers, are never
used. Compiled code is cached on disk; where no folder is writable, kernels compile once per process instead.
"""

import os
import warnings
from collections.abc import Callable
from typing import Any

import numba
import numba.extending

from runtime.errors import MosWarning

Function = Callable[..., Any]  # Numba finds out what the arguments are
compiled: Any = numba.extending.intrinsic  # generates code, without types that a checker could see

# Sums may be contracted and reordered; NaN and infinity keep their meaning (kernels test for them).
FASTMATH = {"contract", "reassoc", "nsz"}

_warned = False


def _compile(function: Function, **options: Any) -> Function:
    global _warned
    try:
        compiled: Function = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
        return compiled
    except RuntimeError as error:  # Numba finds no folder that it may write its cache to
        if "cannot cache function" not in str(error):
            raise
    if not _warned:
        _warned = True
        warnings.warn(
            "no folder for compiled kernels is writable: they are compiled again in every process "
            "(some 10 s). Set NUMBA_CACHE_DIR to a writable folder to keep them.",
            MosWarning,
            stacklevel=4,
        )
    compiled = numba.njit(nogil=True, error_model="numpy", **options)(function)
    return compiled


def kernel(function: Function) -> Function:
    """Compile a kernel with IEEE arithmetic."""
    return _compile(function)


def fast_kernel(function: Function) -> Function:
    """Compile a kernel whose sums may be contracted and reordered (so that loops vectorise)."""
    return _compile(function, fastmath=FASTMATH)


def inlined(function: Function) -> Function:
    """Compile a helper that is inlined into the kernels of its own file."""
    return _compile(function, fastmath=FASTMATH, inline="always")


def is_cached(function: Any) -> bool:
    """Whether compiled code of a kernel lies on disk (or in this process) already."""
    if function.signatures:
        return True
    cache = getattr(function, "_cache", None)
    path = getattr(cache, "_cache_file", None)
    return path is not None and os.path.exists(path._index_path)

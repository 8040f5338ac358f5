"""What compiled code is made from: Numba itself looks at nothing but the file of a kernel."""

import functools
import sys
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np

OURS = ("runtime.", "mos_model.")  # modules with kernels
POLICY = Path(__file__).with_name("jit.py")  # which options they are compiled with
PLAIN = (bool, int, float, complex, str, bytes, tuple, np.generic)  # values that code holds as they are


def ingredients(function: Callable[..., Any]) -> str:
    """Digest of all but the function's own file that goes into its code.

    These are the values of its module's names that it uses, wherever they are imported from, the files of functions
    that it calls, what those use in turn, and the compile policy.
    """
    parts = sorted({_digest(str(POLICY)), *_used(function, set())})
    return sha256("\n".join(parts).encode()).hexdigest()


def _used(function: Any, known: set[Any]) -> Iterator[str]:
    """Of a function and those that it calls, but for `known` ones: names with their values, digests of files."""
    known.add(function)
    for name in _names(function.__code__):
        value = function.__globals__.get(name)
        module = getattr(value, "__module__", None) or ""
        called = getattr(value, "py_func", None)  # of a kernel, the function that it was
        if isinstance(value, np.ndarray):
            yield f"{name} {value.dtype} {value.shape} {sha256(value.tobytes()).hexdigest()}"
        elif isinstance(value, PLAIN):
            yield f"{name} {value!r}"
        elif called is not None:
            yield _digest(called.__code__.co_filename)
            if called not in known:
                yield from _used(called, known)
        elif module.startswith(OURS):  # generates its code itself
            yield _digest(getattr(sys.modules[module], "__file__", None) or "")


def _names(code: CodeType) -> set[str]:
    """Names of its module, among others, that code uses, comprehensions in it included."""
    return set(code.co_names).union(*(_names(part) for part in code.co_consts if isinstance(part, CodeType)))


@functools.cache
def _digest(path: str) -> str:
    try:
        return sha256(Path(path).read_bytes()).hexdigest()
    except OSError:  # packed into one file with Python: its stamp, which Numba takes, is of that whole
        return ""

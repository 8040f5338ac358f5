"""All that this package uses of Numba beyond what Numba documents; another version may have it otherwise.

`pyproject.toml` says which versions are known. Where something is not there all the same, the package does without
it: it says so in the log and goes on.
"""

import functools
import logging
import pickle
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding

log = logging.getLogger("lidar_mos")

MISSING = (ImportError, AttributeError, TypeError)  # what an unknown Numba raises here


@functools.cache
def say_missing(consequence: str) -> None:
    """Log, once, what follows from Numba's lacking something."""
    log.warning("Numba %s is built otherwise than this package knows: %s", numba.__version__, consequence)


@functools.cache
def target() -> tuple[str, str, str]:
    """What Numba compiles for: platform, processor, and features as "+avx2,-avx512f,..."."""
    try:
        from numba.core.registry import cpu_target

        platform, processor, features = cpu_target.target_context.codegen().magic_tuple()
        return platform, processor, features
    except (*MISSING, ValueError):
        say_missing("it is taken to compile for all that this processor has")
        features = getattr(numba.config, "CPU_FEATURES", None)
        if features is None:
            features = binding.get_host_cpu_features().flatten()
        processor = getattr(numba.config, "CPU_NAME", None) or binding.get_host_cpu_name()
        return binding.get_process_triple(), processor, features


def on_compile(call: Callable[[Any], object]) -> AbstractContextManager[Any]:
    """Within, `call(function)` when Numba begins to compile a function, not when that comes from disk."""
    try:
        from numba.core.event import Listener, install_listener

        class Calling(Listener):
            def on_start(self, event: Any) -> None:
                try:
                    function = event.data["dispatcher"].py_func
                except (*MISSING, KeyError):
                    return say_missing("it does not tell which kernel is being compiled")
                call(function)

            def on_end(self, event: Any) -> None:
                pass

        installed: AbstractContextManager[Any] = install_listener("numba:compile", Calling())
        return installed
    except MISSING:
        say_missing("it does not tell which kernel is being compiled")
        return nullcontext()


class Storable:
    """A function whose compiled code goes to files and comes back.

    Raises RuntimeError where no folder for it is writable, one of MISSING where Numba is not as known.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        from numba.core.caching import CompileResultCacheImpl
        from numba.core.serialize import dumps

        self._numba = CompileResultCacheImpl(function)
        self.folder = Path(self._numba.locator.get_cache_path())
        self.name: str = self._numba.filename_base  # module, function, line, version of Python
        closure = [cell.cell_contents for cell in function.__closure__ or ()]
        code = function.__code__.co_code, dumps(closure)
        self.version = repr((numba.__version__, self._numba.locator.get_source_stamp(), code))  # of its own file

    def to_bytes(self, compiled: Any) -> bytes | None:
        """What `from_bytes` takes; None where the code holds addresses of this process."""
        from numba.core.serialize import dumps

        if not self._numba.check_cachable(compiled):
            return None
        return bytes(dumps(self._numba.reduce(compiled)))

    def from_bytes(self, context: Any, data: bytes) -> Any:
        """Compiled code, in the target context that Numba gives."""
        context.refresh()  # else code that calls Numba's own functions would jump to nowhere
        return self._numba.rebuild(context, pickle.loads(data))


def cache_of(kernel: Any) -> Any:
    """What a compiled function takes its code from, and gives it to."""
    return getattr(kernel, "_cache", None)


def set_cache(kernel: Any, cache: object) -> None:
    """Let a compiled function use `cache`. Raises AttributeError where it would not."""
    if not hasattr(kernel, "_cache"):
        raise AttributeError("_cache")
    kernel._cache = cache


def compile_by(take: Callable[[Callable[[], Any]], Any], kernel: Any) -> None:
    """Let what compiles a function when it is called, or brings its code from disk, be taken by `take(step)`."""
    try:
        compile_for = kernel._compile_for_args
    except AttributeError:
        return say_missing("an interrupt may leave its compiler closed for the rest of the process")
    kernel._compile_for_args = lambda *given, **named: take(functools.partial(compile_for, *given, **named))

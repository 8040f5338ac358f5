"""A few threads that run GIL-free kernels side by side, without any process-wide setting."""

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from runtime.errors import SettingError


class Workers:
    """`threads` threads, the caller's among them. Safe after a fork; each runner has its own."""

    def __init__(self, threads: int) -> None:
        if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
            raise SettingError(f"threads must be a whole number of at least 1, not {threads!r}")
        self.threads = threads
        self._pool: ThreadPoolExecutor | None = None
        self._pid = os.getpid()

    def each(self, task: Callable[[int], object], count: int) -> None:
        """Call `task(i)` for i in 0..count-1; an idle thread takes the next i. Raises the first error."""
        helpers = min(self.threads, count) - 1
        if helpers <= 0:
            for i in range(count):
                task(i)
            return
        numbers = itertools.count()

        def take() -> None:
            while (i := next(numbers)) < count:
                task(i)

        futures = [self._executor().submit(take) for _ in range(helpers)]
        try:
            take()
        finally:
            errors = [future.exception() for future in futures]  # also waits for all of them
        for error in errors:
            if error is not None:
                raise error

    def ranges(self, task: Callable[[int, int], object], total: int, grain: int) -> None:
        """Call `task(start, stop)` over 0..total in ranges of `grain`."""
        self.each(lambda i: task(i * grain, min(total, (i + 1) * grain)), -(-total // grain))

    def _executor(self) -> ThreadPoolExecutor:
        if self._pool is None or self._pid != os.getpid():  # threads do not survive a fork
            self._pool = ThreadPoolExecutor(self.threads - 1, thread_name_prefix="mos")
            self._pid = os.getpid()
        return self._pool

    def close(self) -> None:
        """End the threads (they also end with the process)."""
        if self._pool is not None and self._pid == os.getpid():
            self._pool.shutdown(wait=True)
        self._pool = None

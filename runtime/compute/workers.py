"""A few threads that run GIL-free kernels side by side, without any process-wide setting."""

import contextlib
import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait

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
        """Call `task(i)` for i in 0..count-1; an idle thread takes the next i. Raises the first error.

        When it returns or raises, no thread is in a task any more, and none will be.
        """
        helpers = min(self.threads, count) - 1
        if helpers <= 0:
            for i in range(count):
                task(i)
            return
        numbers, stopped = itertools.count(), threading.Event()
        futures: list[Future[None]] = []

        def take() -> None:
            while not stopped.is_set() and (i := next(numbers)) < count:
                task(i)

        try:
            with contextlib.suppress(RuntimeError):  # the system starts no more threads: those there are do it all
                for _ in range(helpers):
                    futures.append(self._executor().submit(take))
            take()
        except BaseException:
            stopped.set()
            raise
        finally:
            _finish(futures, stopped)
        for future in futures:
            if not future.cancelled() and (error := future.exception()) is not None:
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


def _finish(futures: list[Future[None]], stopped: threading.Event) -> None:
    """Wait for those that have begun, whatever interrupts the wait; the others will not begin."""
    interrupted: BaseException | None = None
    running = [future for future in futures if not future.cancel()]
    while running:
        try:
            running = list(wait(running).not_done)
        except BaseException as error:
            stopped.set()
            interrupted = error
    if interrupted is not None:
        raise interrupted

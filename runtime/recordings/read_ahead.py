"""Reading off the critical path: the next scan is read while this one is worked on."""

from collections.abc import Generator, Iterator
from contextlib import suppress
from contextvars import copy_context
from queue import Empty, Queue
from threading import Event, Thread

from runtime.recordings.recording import Scan


def read_ahead(scans: Iterator[Scan]) -> Generator[Scan, None, None]:
    """The same scans, in order; a thread reads on meanwhile, one that waits and one that is being read at most.

    An error comes in the place of its scan, and ends them. `close()` ends the thread, after the scan that it reads.
    """
    ready: Queue[Scan | BaseException | None] = Queue(1)
    stop = Event()

    def read() -> None:
        last: BaseException | None = None
        try:
            for scan in scans:
                ready.put(scan)
                if stop.is_set():
                    break
            if isinstance(scans, Generator):
                scans.close()  # here, where its files were opened
        except BaseException as error:  # whatever it is, it is raised where the scan is wanted
            last = error
        ready.put(last)

    thread = Thread(target=copy_context().run, args=(read,), name="read-ahead", daemon=True)
    thread.start()
    try:
        while (item := ready.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        stop.set()
        while thread.is_alive():
            with suppress(Empty):
                ready.get(timeout=0.01)

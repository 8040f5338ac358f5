"""A step that is done as a whole or not at all, whatever signal comes: Ctrl-C, or a time that is up."""

import threading
from collections.abc import Callable
from contextvars import copy_context
from typing import TypeVar

Result = TypeVar("Result")


def undisturbed(step: Callable[[], Result]) -> Result:
    """What `step()` returns or raises. Signals cut nothing in two but the main thread, so another one takes it there.

    What a signal raised meanwhile is raised when the step is done, or has not begun and never will.
    """
    if threading.current_thread() is not threading.main_thread():
        return step()
    begun, done = threading.Lock(), threading.Event()
    results: list[Result] = []
    errors: list[BaseException] = []

    def take() -> None:
        if not begun.acquire(blocking=False):
            return
        try:
            results.append(step())
        except BaseException as error:  # raised where it is waited for
            errors.append(error)
        finally:
            done.set()

    raised: BaseException | None = None
    try:
        threading.Thread(target=copy_context().run, args=(take,), name="mos-step").start()
    except RuntimeError:  # no more threads, or the program ends
        take()
    except BaseException as error:
        raised = error
        if begun.acquire(blocking=False):
            raise
    while not done.is_set():
        try:
            done.wait()
        except BaseException as error:
            raised = error
    if raised or errors:
        raise raised or errors[0]
    return results[0]

"""Recordings side by side, each in one of several processes of this machine."""

import multiprocessing
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from runtime.errors import InferenceError, MosError, is_interrupt
from runtime.fleet.doing import Telling, do
from runtime.fleet.events import Divided, Done, Hear, Said
from runtime.fleet.plan import Plan, Task
from runtime.fleet.remote import Place
from runtime.fleet.voice import heard
from runtime.fleet.work import Work

AGAIN = 3  # times that a recording is tried again whose process died
PATIENCE = 10.0  # s in which a process is to end by itself
READY = "ready"


def label_in_processes(work: Work, places: Sequence[Place], *, jobs: int, hear: Hear) -> None:
    """A process that dies, as one that the system kills for want of memory, has its recording tried again.

    Threads are divided among the processes, one each at least. Raises what `Work.runner` does, and InferenceError where
    processes die before they begin.
    """
    threads = max(1, (work.settings.threads or 1) // jobs)
    crew = _Crew(replace(work, settings=replace(work.settings, threads=threads)))
    plan, lost = Plan(work, places, hear), 0  # processes that died in a row before they were ready
    with crew:
        for _ in range(jobs if work.piece else min(jobs, len(places))):
            crew.start()
        while crew.give(plan):
            for worker in crew.heard_from():
                try:
                    event = worker.connection.recv()
                except (EOFError, OSError):
                    task, why = worker.task, crew.bury(worker)
                    lost += task is None and not worker.ready
                    if lost > AGAIN:
                        raise InferenceError(f"processes that are to label die when they start ({why})") from None
                    if task and task.again < AGAIN:
                        hear(Said(task.name, f"its process died ({why}), and it is tried again", warning=True))
                        plan.first(task.once_more())
                    elif task:
                        plan.hear(task, Done(task.name, f"its process died ({why}), {AGAIN + 1} times in a row"))
                    if plan.waits:
                        crew.start()
                    continue
                if isinstance(event, MosError):
                    raise event
                if event == READY:
                    worker.ready, lost = True, 0
                elif worker.task:
                    plan.hear(worker.task, event)
                else:
                    hear(event)
                if isinstance(event, Done | Divided):
                    worker.task = None


@dataclass
class _Worker:
    """A process, from outside."""

    process: SpawnProcess
    connection: Connection
    ready: bool = False
    task: Task | None = None


class _Crew:
    """The processes. None outlives the block."""

    def __init__(self, work: Work) -> None:
        self.workers: list[_Worker] = []
        self._work = work

    def __enter__(self) -> "_Crew":
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        for worker in self.workers:
            worker.connection.close()
            if kind:
                worker.process.terminate()
        for worker in self.workers:
            worker.process.join(PATIENCE)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()

    def start(self) -> None:
        """One more."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self._work), daemon=True)
        with _no_interrupt():
            process.start()
        theirs.close()
        self.workers.append(_Worker(process, ours))

    def give(self, plan: Plan) -> bool:
        """Tasks to those that are ready for one; False where nothing is to be done any more."""
        for worker in self.workers:
            if worker.ready and not worker.task and (task := plan.next()):
                worker.task = task
                with suppress(OSError):  # it died: that is heard next
                    worker.connection.send(task)
        return plan.waits or any(one.task for one in self.workers)

    def heard_from(self) -> list[_Worker]:
        """Those that said something, or died."""
        ready = wait([one.connection for one in self.workers])
        return [one for one in self.workers if one.connection in ready]

    def bury(self, worker: _Worker) -> str:
        """Of one that died: how."""
        self.workers.remove(worker)
        worker.connection.close()
        worker.process.join(PATIENCE)
        code = worker.process.exitcode
        return f"by {signal.Signals(-code).name}" if code and code < 0 else f"with exit code {code}"


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Within, Ctrl-C does nothing, and never to processes that are started here: it is for the one that has them."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _serve(connection: Connection, work: Work) -> None:
    """What such a process does, until nobody has work for it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)
    try:
        with heard(Telling("", connection.send)), work.runner() as runner:
            connection.send(READY)
            while True:
                task = connection.recv()
                connection.send(do(work, runner, task, connection.send))
    except MosError as error:
        connection.send(error)
    except (EOFError, ConnectionError):  # the one that has it is gone, or needs it no more
        pass
    except BaseException as error:
        if not is_interrupt(error):
            raise


def _end(number: int, frame: object) -> None:
    raise KeyboardInterrupt

"""A recording a task of Ray, on all machines of a cluster."""

import os
import pickle
from collections.abc import Sequence
from functools import lru_cache

from runtime.compute.packages import RAY, need_package
from runtime.errors import MosError
from runtime.fleet.doing import do
from runtime.fleet.events import Done, Event, Hear, Said
from runtime.fleet.plan import Plan, Task
from runtime.fleet.remote import Place
from runtime.fleet.work import Work
from runtime.runner import MosRunner

AGAIN = 3  # times that a task is tried again whose process or machine was lost


def label_on_ray(work: Work, places: Sequence[Place], *, address: str | None, hear: Hear) -> None:
    """address: "ray://HOST:PORT"; None: what RAY_ADDRESS says, or the cluster that runs here, or else a new one of this
    machine alone. All machines see recordings and results at the same paths, and have this package and bundle.

    Raises MissingPackageError, MosError where there is no such cluster, and what `Work.runner` does on any machine.
    """
    need_package(RAY, "labelling on several machines")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # before anything of Ray starts
    import ray

    threads = work.settings.threads or 1
    try:
        ray.init(address=address, log_to_driver=False, logging_level="warning")
    except Exception as error:  # of any kind, as a bare one where a machine is too busy to start
        raise MosError(f"no cluster of Ray at {address or 'this machine'}: {error}") from error
    try:
        if threads > max((node["Resources"].get("CPU", 0) for node in ray.nodes() if node["Alive"]), default=0):
            hear(Said("ray", f"no machine has {threads} processors (`threads`) yet: tasks wait for one", warning=True))
        labelling = ray.remote(num_cpus=threads, max_retries=AGAIN)(_label)
        packed = ray.put(pickle.dumps(work))
        plan, running = Plan(work, places, hear), {}
        while True:
            while task := plan.next():
                running[labelling.remote(packed, task)] = task
            if not running:
                break
            (ready, *_), _ = ray.wait(list(running))
            task = running.pop(ready)
            try:
                for event in ray.get(ready):
                    plan.hear(task, event)
            except ray.exceptions.RayTaskError as error:
                raise error.cause if isinstance(error.cause, MosError) else error from None
            except ray.exceptions.RayError as error:  # its process, or its machine
                plan.hear(task, Done(task.name, f"was lost {AGAIN + 1} times: {error}"))
    finally:
        ray.shutdown()  # which ends the tasks that run


def _label(packed: bytes, task: Task) -> list[Event]:
    """What such a task does: all that is heard of it, `Done` or `Divided` last."""
    work, runner = _made(packed)
    told: list[Event] = []
    done = do(work, runner, task, lambda event: told.append(event) if isinstance(event, Said) else None)
    return [*told, done]


@lru_cache(maxsize=1)
def _made(packed: bytes) -> tuple[Work, MosRunner]:
    """Once a process, in which tasks of the same work follow each other."""
    work: Work = pickle.loads(packed)
    return work, work.runner()

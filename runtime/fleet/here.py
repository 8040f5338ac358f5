"""One recording after the other, in this process."""

from collections.abc import Sequence
from functools import partial

from runtime.fleet.at_hand import release
from runtime.fleet.doing import do
from runtime.fleet.events import Hear
from runtime.fleet.plan import Plan
from runtime.fleet.remote import Place
from runtime.fleet.work import Work


def label_here(work: Work, places: Sequence[Place], hear: Hear) -> None:
    """Raises what `Work.runner` does."""
    plan = Plan(work, places, hear)
    try:
        with work.runner() as runner:
            while task := plan.next():
                plan.hear(task, do(work, runner, task, partial(plan.hear, task)))
    finally:
        release()

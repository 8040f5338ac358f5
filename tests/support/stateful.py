"""How many examples state machines try: few and the same each time, or as many others as `bench.faults` asks for."""

import os

from hypothesis import HealthCheck, Phase, settings

EXAMPLES = "MOS_EXAMPLES"  # the variable by which it does


def examples(few: int, steps: int = 20, shrink: bool = True) -> settings:
    """Without deadlines: a test may be stopped for minutes. shrink: what fails, which takes many more steps."""
    many = int(os.environ.get(EXAMPLES, 0))
    checks = [HealthCheck.too_slow]
    return settings(
        max_examples=many or few,
        stateful_step_count=steps,
        derandomize=not many,
        deadline=None,
        database=None,
        suppress_health_check=checks,
        phases=[Phase.generate, *([Phase.shrink] if shrink else [])],
    )

"""How many examples state machines try: few and the same each time, or as many others as `bench.faults` asks for."""

import os

from hypothesis import HealthCheck, settings

EXAMPLES = "MOS_EXAMPLES"  # the variable by which it does


def examples(few: int) -> settings:
    """Without deadlines: a test may be stopped for minutes."""
    many = int(os.environ.get(EXAMPLES, 0))
    checks = [HealthCheck.too_slow]
    return settings(
        max_examples=many or few, derandomize=not many, deadline=None, database=None, suppress_health_check=checks
    )

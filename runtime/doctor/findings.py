"""What `mos doctor` has to say: one finding a check, in plain words."""

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warn", "bad"]


@dataclass(frozen=True)
class Finding:
    """ok: as it should be. warn: worth a look. bad: results will be wrong, or the sequence cannot be run."""

    level: Level
    topic: str
    text: str


def percent(share: float) -> str:
    """A share as text: 12 %, 0.3 %, under 0.1 %."""
    value = 100 * share
    if 0 < value < 0.1:
        return "under 0.1 %"
    return f"{value:.0f} %" if value >= 10 or value == 0 else f"{value:.1f} %"

"""What was done while a system ran."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

REMEMBERED = 100_000  # latencies
OTHER_CLOCK = 60.0  # s from its stamp to now, beyond which a scan has the stamp of another clock


def _latencies() -> deque[float]:
    return deque(maxlen=REMEMBERED)


@dataclass
class LiveSummary:
    """Of scans, from the first that was labelled on."""

    scans: int = 0  # labelled and published
    before: int = 0  # that came while the first was prepared, or poses were waited for
    dropped: int = 0  # that came while an older one was labelled, and then a newer one came
    lost: int = 0  # by DDS, on the way here
    unposed: int = 0  # without a pose at their time
    broken: int = 0  # messages that are no scans
    slow: int = 0  # publications for which a subscriber was too slow
    from_stamp: deque[float] = field(default_factory=_latencies)  # s, from the stamp of each scan to its publication
    from_arrival: deque[float] = field(default_factory=_latencies)  # s, from when it was here

    @property
    def same_clock(self) -> bool:
        """Whether stamps are of this machine's clock, or of one that goes with it."""
        return bool(self.from_stamp) and abs(float(np.median(self.from_stamp))) <= OTHER_CLOCK

    def latency(self) -> tuple[float, float]:
        """Median and 95th percentile, s: from the stamp, or from the arrival where stamps are of another clock."""
        p50, p95 = np.percentile(self.from_stamp if self.same_clock else self.from_arrival, [50, 95])
        return float(p50), float(p95)

    def text(self) -> str:
        """All of it in words."""
        counts = {
            "dropped": self.dropped,
            "lost on the way": self.lost,
            "without a pose": self.unposed,
            "broken": self.broken,
            "before the first": self.before,
            "publications too slowly taken": self.slow,
        }
        told = [f"{count} {what}" for what, count in counts.items() if count or what == "dropped"]
        text = f"{self.scans} scans; {', '.join(told)}"
        if self.from_stamp:
            p50, p95 = self.latency()
            since = "stamp" if self.same_clock else "arrival (stamps are of another clock)"
            text += f"; from {since} to publication {1000 * p50:.0f} ms, p95 {1000 * p95:.0f} ms"
        return text

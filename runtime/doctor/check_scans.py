"""Do scans hold what the network expects: finite points, metres, remission in 0..1?

Each check takes samples of some scans, of a recording or of the last few of a stream, and goes by their median: no
single scan decides. Samples with hardly a usable point are left out.
"""

from collections.abc import Sequence
from statistics import fmean

from runtime.doctor.check_ground import check_ground
from runtime.doctor.findings import Finding, percent
from runtime.doctor.sample import Sample, middle, quantile, share_below
from runtime.sensors.sensor import UNKNOWN_REACH

FARTHEST = 200.0  # m, median range that no scan in metres has; streets and rooms have 2 to 25
NEAREST = 1.0  # m, within which no scan in metres lies as a whole
LOW, HIGH = -1.0, 1.5  # remission that is no rounding of 0..1
STRAY = 0.05  # share of the points that may have another remission, or lie out of reach
HALF = 0.5  # share of the points from which on what is missing is no exception


def check_scans(samples: Sequence[Sample]) -> list[Finding]:
    """All that samples of scans tell, whatever the sensor; at least one sample."""
    seen = [sample for sample in samples if sample.tells]
    found = _check_points(samples, seen)
    if not seen:
        return [*found, Finding("bad", "points", "no scan holds usable points")]
    return [*found, _check_range(seen), _check_remission(seen), check_ground(seen)]


def _check_points(samples: Sequence[Sample], seen: Sequence[Sample]) -> list[Finding]:
    """NaN, infinity, points at the origin, and points out of reach."""
    found = []
    if infinite := fmean(sample.infinite for sample in samples):
        found.append(_left_out(infinite, "hold NaN or infinity in x, y or z", most=0))
    if origin := fmean(sample.origin for sample in samples):
        found.append(_left_out(origin, "lie at the origin (no return)", most=HALF))
    if far := fmean([1 - share_below(sample.sorted_ranges, UNKNOWN_REACH) for sample in seen] or [0]):
        found.append(_left_out(far, f"lie beyond {UNKNOWN_REACH:g} m", most=STRAY))
    return found


def _left_out(share: float, what: str, most: float) -> Finding:
    return Finding("warn" if share > most else "ok", "points", f"{percent(share)} {what}; left out and never moving")


def _check_range(samples: Sequence[Sample]) -> Finding:
    """The unit of length, as far as ranges tell it."""
    near, far = (middle(quantile(sample.sorted_ranges, share) for sample in samples) for share in (0.05, 0.99))
    half = middle(sample.middle for sample in samples)
    text = f"half of the points lie within {half:.3g} m, 5 % within {near:.3g} m, 99 % within {far:.3g} m"
    needed = "the network needs metres in the LiDAR's frame"
    if half > FARTHEST:
        return Finding("bad", "range", f"{text}: that looks like millimetres or map coordinates; {needed}")
    if far < NEAREST:
        return Finding("bad", "range", f"{text}: that looks like kilometres; {needed}")
    if half < NEAREST:
        return Finding("warn", "range", f"{text}: very near; are these metres?")
    return Finding("ok", "range", text)


def _check_remission(samples: Sequence[Sample]) -> Finding:
    given = [sample for sample in samples if sample.remissions is not None]
    if not given:
        return Finding("ok", "remission", "none: the network does without one of its channels")
    missing = middle(1 - len(sample.known_remissions) / len(sample.ranges) for sample in given)
    if missing > HALF:
        text = (
            f"{percent(missing)} are NaN or infinite: they count as missing; where there are none, leave the column out"
        )
        return Finding("bad", "remission", text)
    known = [sample.known_remissions for sample in given if len(sample.known_remissions)]
    low, high = (middle(quantile(values, share) for values in known) for share in (0.01, 0.99))
    text = f"98 % from {low:.3g} to {high:.3g}, mean {middle(float(values.mean()) for values in known):.3g}"
    if middle(share_below(values, LOW) for values in known) > STRAY:
        text += ": the network needs 0..1, and none is negative; are the records 4 float32 each, x y z remission?"
        return Finding("bad", "remission", text)
    if middle(1 - share_below(values, HIGH) for values in known) > STRAY:
        full = 255 if high <= 255 else 65535
        return Finding(
            "bad", "remission", f"{text}: the network needs 0..1; divide by {full}, or what else is the highest"
        )
    if missing > STRAY:
        return Finding("warn", "remission", f"{text}; {percent(missing)} are NaN or infinite and count as missing")
    if low == high:
        return Finding("warn", "remission", f"{text}: it is constant, so that the network misses one of its channels")
    if low < 0 or high > 1:
        return Finding("warn", "remission", f"{text}: the network needs 0..1")
    return Finding("ok", "remission", text)

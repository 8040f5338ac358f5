"""What `mos doctor` calls bad about a recording, noticed while its scans come in one by one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.doctor.alignment import LAGS, WITNESSES, Fit, check_fits, fit
from runtime.doctor.check_scans import check_scans
from runtime.doctor.check_sensor import check_view
from runtime.doctor.findings import Finding
from runtime.doctor.ground import find_ground
from runtime.doctor.landmarks import View, upright_points
from runtime.doctor.sample import Sample
from runtime.image.history import Past
from runtime.sensors.range_image import RangeImage

CLOSELY, RARE = 24, 8  # scans of a recording that are each a turn; after them, one in so many is
SAMPLE_EVERY, FIT_EVERY = 6, 3  # turns; they never meet
SAMPLES = 3  # the last ones, which are judged together
POINTS = 1024  # of a scan that are looked at


@dataclass(frozen=True)
class Memory:
    """What is known of the recording so far."""

    scans: int = 0
    samples: tuple[Sample, ...] = ()  # the last SAMPLES
    fits: tuple[Fit, ...] = ()  # the last WITNESSES of each lag
    told: frozenset[str] = frozenset()  # topics that need no second word


@dataclass(frozen=True)
class Look:
    """What a scan brought. It counts once it is given to `Watch.keep`: a call that fails leaves all as it was."""

    warnings: tuple[str, ...]
    memory: Memory


class Watch:
    """Looks at some scans of a stream, at a cost far below that of labelling them."""

    def __init__(self, geometry: RangeImage) -> None:
        """geometry: of the range images that it will see. Compiles the kernels."""
        self._geometry = geometry
        self._memory = Memory()
        nothing = np.zeros((1, 3), np.float32)
        find_ground(nothing, nothing[:, 0], 1.0)
        View(np.zeros((2, 2), np.float32), geometry).misfit(upright_points(nothing), np.eye(4))

    def reset(self) -> None:
        """The next scan is the first of a recording."""
        self._memory = Memory()

    def keep(self, look: Look) -> None:
        """The scan of this look is one of the recording."""
        self._memory = look.memory

    def look(self, scan: ArrayLike, ranges: Callable[[], NDArray[np.float32]], past: Sequence[Past]) -> Look:
        """New warnings after the next scan, at most one a topic in a recording.

        scan: as it was given to the runner, (N, 4) or (N, 3); ranges: its range image (H, W) m, 0 where it is empty,
        for which not every scan asks; past: the scans 1, 2, ... before it.
        """
        memory = self._memory
        turn, found = _turn(memory.scans), []
        if turn is not None and turn % SAMPLE_EVERY == 0:
            memory = replace(memory, samples=(*memory.samples, Sample.of(np.asarray(scan), POINTS))[-SAMPLES:])
            found = self._judge(memory.samples)
        if turn is not None and turn % FIT_EVERY == FIT_EVERY - 1 and "alignment" not in memory.told:
            lag = LAGS[turn // FIT_EVERY % len(LAGS)]
            if lag <= len(past):
                memory = replace(memory, fits=self._fits(memory.fits, ranges(), past[lag - 1], lag))
                found = [check_fits(memory.fits)]
        bad = {one.topic: one.text for one in found if one and one.level == "bad" and one.topic not in memory.told}
        told = memory.told.union(bad)
        return Look(
            tuple(f"{topic}: {text}" for topic, text in bad.items()), replace(memory, scans=memory.scans + 1, told=told)
        )

    def _judge(self, samples: tuple[Sample, ...]) -> list[Finding | None]:
        """Bad findings count only where all samples tell something, or none does: two are no majority."""
        telling = sum(sample.tells for sample in samples)
        if len(samples) < SAMPLES or 0 < telling < SAMPLES:
            return []
        return [*check_scans(samples), check_view(samples, self._geometry) if telling else None]

    def _fits(self, before: tuple[Fit, ...], ranges: NDArray[np.float32], past: Past, lag: int) -> tuple[Fit, ...]:
        view = View(ranges, self._geometry)
        new = fit(view, upright_points(past.points), past.relative, lag, before)
        return (*before, new)[-WITNESSES * len(LAGS) :]


def _turn(scan: int) -> int | None:
    """The number of a scan, counted from 0, among those that may be looked at; None if it is not one of them."""
    if scan < CLOSELY:
        return scan
    return None if scan % RARE else CLOSELY + (scan - CLOSELY) // RARE

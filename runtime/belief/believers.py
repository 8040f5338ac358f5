"""From the labels of one scan to those of one scan among others: what was found at a place counts there again, what
others see through was not there, and what touches agrees."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.belief.free_space import FreeSpace
from runtime.belief.memory import Memory
from runtime.belief.objects import agree, find_objects
from runtime.belief.places import Places, Surveyor
from runtime.belief.trail import NO_TRAIL, Trail, follow
from runtime.bundle.manifest import BeliefNumbers, Manifest, SensorEntry
from runtime.compute.jit import kernel
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.head.refiners import PointLabels
from runtime.image.entry import Entered
from runtime.recordings.poses import Pose
from runtime.settings import RunnerSettings

_GRAIN = 16_384  # points per task


Seen = Callable[[], NDArray[np.float32]]  # the range image of a scan


class Believed(NamedTuple):
    """What is believed of a scan, and what is to be remembered of it: `Believer.add` does, once nothing can fail."""

    labels: PointLabels
    places: Places | None


class Believer(Protocol):
    """The step after the labels of a scan."""

    horizon: int  # past scans that count; older ones are forgotten exactly

    def serve(self, entry: SensorEntry) -> None:
        """From now on scans of this sensor, by its thresholds."""

    def believe(self, scan: Entered, pose: Pose, labels: PointLabels, seen: Seen, follows: bool) -> Believed:
        """Labels of the points of a scan, T_world_lidar = `pose`; follows: the scan before, and not after a jump.

        seen: the scan's range image (H, W) m, for the asking; may be a buffer that lasts until it is added.
        """

    def add(self, places: Places | None) -> None:
        """Remember what was found at the places of the last scan."""

    def judge(self, places: Places) -> PointLabels:
        """Labels of an earlier scan, by all that is known now."""

    def clear(self) -> None:
        """Forget everything."""


class Unbelieving:
    """Every scan by itself."""

    horizon = 0

    def serve(self, entry: SensorEntry) -> None:
        """See `Believer`."""

    def believe(self, scan: Entered, pose: Pose, labels: PointLabels, seen: Seen, follows: bool) -> Believed:
        """See `Believer`."""
        return Believed(labels, None)

    def add(self, places: Places | None) -> None:
        """See `Believer`."""

    def judge(self, places: Places) -> PointLabels:
        """See `Believer`: there are no places, so none are asked for."""
        raise NotImplementedError

    def clear(self) -> None:
        """See `Believer`."""


class Online:
    """Adds to the log-odds of a point what the last scans found and saw at its place, and lets objects agree.

    A first scan keeps its labels.
    """

    def __init__(self, numbers: BeliefNumbers, entry: SensorEntry, workers: Workers, later: int = 0) -> None:
        """entry: the sensor to begin with; later: scans that are remembered beside those that count."""
        self.horizon = max(numbers.horizon, numbers.look_back) + numbers.longest_trail + later
        self._numbers, self._workers = numbers, workers
        self._surveyor = Surveyor(numbers.voxel_size, workers)
        self._memory = Memory(numbers.horizon + later, workers)
        self._free_space = FreeSpace(numbers, entry.range_image, workers, later)
        self._trails: dict[int, Trail] = {}  # of the scan judged last and of that before it, by their numbers
        self.serve(entry)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return self._surveyor.nbytes + self._memory.nbytes + self._free_space.nbytes

    def serve(self, entry: SensorEntry) -> None:
        """See `Believer`."""
        self._threshold = _as_number(self._threshold_of(entry))
        self._free_space.lay_out(entry.range_image)

    def _threshold_of(self, entry: SensorEntry) -> float | None:
        return entry.decision.belief_threshold

    def believe(self, scan: Entered, pose: Pose, labels: PointLabels, seen: Seen, follows: bool) -> Believed:
        """See `Believer`."""
        places = self._survey(scan, pose, labels, seen)
        return Believed(self.judge(places) if follows else labels, places)

    def _survey(self, scan: Entered, pose: Pose, labels: PointLabels, seen: Seen) -> Places:
        sight = self._free_space.sight(scan.points, pose, seen())
        return self._surveyor.survey(sight, scan.takes_part, labels.probability)

    def judge(self, places: Places) -> PointLabels:
        """See `Believer`."""
        weight, floor = np.float32(self._numbers.weight), np.float32(self._numbers.floor)
        belief = np.maximum(weight * self._memory.recall(places.keys), floor)
        count = len(places.place)
        log_odds = np.empty(count, np.float32)
        self._in_ranges(lambda part: _weigh(places.log_odds[part], places.place[part], belief, log_odds[part]), count)
        if self._numbers.object_probability < 1:
            self._look_at_objects(places, log_odds)
        believed = PointLabels(np.empty(count, np.bool_), np.empty(count, np.float32))
        self._in_ranges(
            lambda part: _decide(
                log_odds[part], places.place[part], self._threshold, believed.moving[part], believed.probability[part]
            ),
            count,
        )
        return believed

    def _look_at_objects(self, places: Places, log_odds: NDArray[np.float32]) -> None:
        """Let what others see, and what surely moved a moment ago, count for objects; changes the log-odds (N,)."""
        numbers, sight = self._numbers, places.sight
        least = _logit(numbers.object_probability)
        self._free_space.weigh(sight, log_odds, least)
        objects = find_objects(places, log_odds, least)
        before = self._trails.get(sight.number - 1, NO_TRAIL)
        trail, inside = follow(objects, before, _logit(numbers.sure), numbers.longest_trail)
        self._trails = {sight.number - 1: before, sight.number: trail}  # the same if a scan is judged again
        agree(objects, np.float32(numbers.in_trail) * inside, log_odds, _logit(numbers.doubtful))

    def _in_ranges(self, kernel: Callable[[slice], None], count: int) -> None:
        self._workers.ranges(lambda start, stop: kernel(slice(start, stop)), count, _GRAIN)

    def add(self, places: Places | None) -> None:
        """See `Believer`."""
        if places is not None:
            self._memory.add(places.keys, places.evidence)
            self._free_space.add(places.sight)

    def clear(self) -> None:
        """See `Believer`."""
        self._memory.clear()
        self._free_space.clear()
        self._trails = {}


class Delayed(Online):
    """Leaves labels as they are until `judge` is asked, when `delay` later scans are known too.

    They say more than trails, without which simulated drives have 0.6 points of moving IoU more.
    """

    def __init__(self, numbers: BeliefNumbers, entry: SensorEntry, workers: Workers, delay: int) -> None:
        super().__init__(replace(numbers, longest_trail=0, in_trail=0.0), entry, workers, later=delay)

    def _threshold_of(self, entry: SensorEntry) -> float | None:
        return entry.decision.delayed_threshold

    def believe(self, scan: Entered, pose: Pose, labels: PointLabels, seen: Seen, follows: bool) -> Believed:
        """See `Believer`."""
        return Believed(labels, self._survey(scan, pose, labels, seen))


def choose_believer(
    settings: RunnerSettings, postprocess: str, manifest: Manifest, entry: SensorEntry, workers: Workers
) -> Believer:
    """What the settings `belief` and `delay` ask for; entry: the sensor to begin with.

    Raises SettingError with the post-processing "knn", whose votes are no probabilities.
    """
    numbers = manifest.tuned.belief
    wanted = settings.belief == "online" or settings.delay > 0
    if settings.belief == "none" or not (wanted or (numbers and postprocess != "knn")):
        return Unbelieving()
    if postprocess == "knn":
        raise SettingError("belief adds up probabilities, and knn has votes: choose postprocess head or none")
    numbers = numbers or BeliefNumbers()
    if settings.delay:
        return Delayed(numbers, entry, workers, settings.delay)
    return Online(numbers, entry, workers)


def _as_number(threshold: float | None) -> np.float32:
    """Without a threshold, the most likely class."""
    return np.float32(0.5 if threshold is None else threshold)


def _logit(probability: float) -> float:
    return math.log(probability / (1 - probability))


@kernel
def _weigh(log_odds, place, belief, total):  # type: ignore[no-untyped-def]
    """Add up."""
    for i in range(place.size):
        total[i] = log_odds[i] + belief[place[i]] if place[i] >= 0 else np.float32(0)


@kernel
def _decide(log_odds, place, threshold, moving, probability):  # type: ignore[no-untyped-def]
    one = np.float32(1)
    for i in range(place.size):
        probability[i] = one / (one + np.exp(-log_odds[i])) if place[i] >= 0 else np.float32(0)
        moving[i] = probability[i] > threshold

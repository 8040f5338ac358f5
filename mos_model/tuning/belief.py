"""From which probability on a point counts as moving where what past scans found at its place counts too."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from mos_model.data.dataset import Sample
from mos_model.networks.checkpoint import Checkpoint, load
from mos_model.simulator import simulate
from mos_model.tuning.histogram import Histogram
from mos_model.tuning.thresholds import LIGHT_TRAFFIC, probabilities, samples_of
from runtime.belief.believers import Delayed, Online
from runtime.bundle.manifest import SensorEntry, Tuned
from runtime.classes import to_classes
from runtime.compute.workers import Workers
from runtime.head.refiners import PointLabels
from runtime.image.entry import Entered
from runtime.image.history import History
from runtime.image.inputs import ImageInput
from runtime.image.making import make_inputs
from runtime.recordings.poses import check_pose
from runtime.sensors.registry import find_sensor

BELIEF_DRIVES = 18_000_000  # seeds from here on; nothing else has them
SCANS = 34  # of each drive
DELAY = 10  # scans, for which the threshold of what is judged later is found
_NONE = np.empty(0, np.uint8)


class Believed(NamedTuple):
    """Points of drives by what is believed of them, at once and DELAY scans later."""

    online: Histogram
    delayed: Histogram


def find_belief(checkpoint: Path, tuned: Tuned, sensors: Sequence[str], drives: int) -> Believed:
    """What is believed on simulated drives of some sensors, which take turns. Every second drive has no mover.

    tuned: with the numbers of belief. Every second drive with movers, and without, is of the wide variety that a
    network of several sensors learnt from.
    """
    torch.set_num_threads(1)
    found, online, delayed = load(checkpoint), Histogram(), Histogram()
    for number in range(drives):
        sensor = sensors[number // 2 % len(sensors)]
        settings: dict[str, Any] = {"movers": LIGHT_TRAFFIC if number % 2 else 0.0}
        if found.config.other_sensors and number // 2 % 2:
            settings["version"] = 2
        count_drive(found, tuned, sensor, BELIEF_DRIVES + number, settings, online, delayed)
    return Believed(online, delayed)


def count_drive(
    found: Checkpoint,
    tuned: Tuned,
    sensor: str,
    seed: int,
    settings: dict[str, Any],
    online: Histogram,
    delayed: Histogram,
) -> None:
    """Count the points of a simulated drive by what is believed of them at once, and DELAY scans later."""
    samples, workers = samples_of(found, sensor), Workers(1)
    inputs = make_inputs(samples.view, workers, find_sensor(sensor).reach)
    history = History(tuned)
    assert tuned.belief is not None
    entry = SensorEntry(sensor, samples.view.range_image)
    now, later = Online(tuned.belief, entry, workers), Delayed(tuned.belief, entry, workers, DELAY)
    waiting = []
    for scan in simulate(seed, SCANS, sensor=sensor, **settings):
        entered, pose = inputs.enter(scan.points), check_pose(scan.pose, "pose")
        past = history.past(pose)
        labels = _labels(found, entered, inputs.build(entered, past), tuned.candidate)
        classes = to_classes(scan.labels)
        seen = partial(inputs.range_image, entered)
        believed = now.believe(entered, pose, labels, seen, follows=bool(past))
        online.add(believed.labels.probability, classes)
        now.add(believed.places)
        places = later.believe(entered, pose, labels, seen, follows=bool(past)).places
        assert places is not None
        later.add(places)
        waiting.append((places.copy(), classes))
        history.add(entered, pose, None)
        if len(waiting) > DELAY:
            earlier, its_classes = waiting.pop(0)
            delayed.add(later.judge(earlier).probability, its_classes)


def _labels(found: Checkpoint, entered: Entered, image: ImageInput, candidate: float) -> PointLabels:
    """What the network says of each point by itself."""
    seen = image.pixel >= 0
    sample = Sample(image.image, _NONE, entered.points[seen, :3], image.pixel[seen], _NONE)
    probability = np.zeros(len(entered), np.float32)
    _, probability[seen] = probabilities(found, sample, candidate)
    return PointLabels(probability > 0.5, probability)

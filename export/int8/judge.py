"""INT8 export: calibrate, write, measure what it costs, and leave in float what does not bear it."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import expit, logit
from torch import nn

from export.int8.prepare import Prepared, prepare
from mos_model.data.dataset import SampleConfig, SimulatedStreets
from runtime.bundle.residual import HISTORY, Residual
from runtime.classes import MOVING, UNLABELLED
from runtime.compute.sessions import open_session
from runtime.compute.workers import Workers
from runtime.doctor.check_scans import Samples, check_points, check_sensor
from runtime.errors import MosWarning, QuantisationError, ScanError, SequenceError
from runtime.evaluation.confusion import Confusion
from runtime.image.decision import pixel_classes
from runtime.image.inputs import InputBuilder
from runtime.recordings.sequence import open_sequence
from runtime.sensors.range_image import RangeImage

CALIBRATION_STREETS = 16_000_000  # seeds of the simulated streets for ranges; nothing else has them
JUDGING_STREETS = 17_000_000  # and of those on which the loss is measured
LIMIT = 0.5  # percentage points of IoU of the moving class that may be lost
MOST_FLOAT = 0.25  # share of the layers that may stay in float
QUICK = 4  # scans on which single layers are judged
LARGEST_SHIFT = 1.0  # of the logit of moving
LEAST = 1e-7  # probability that is told from none


class Scene(NamedTuple):
    """A scan as the network sees it."""

    image: np.ndarray  # (1, 5 + lags, H, W) f32
    labels: np.ndarray  # (H, W) 0 unlabelled, 1 static, 2 moving


@dataclass(frozen=True)
class Settings:
    """What an INT8 export looks at."""

    streets: int = 8  # simulated streets for the ranges, two scans each
    judging: int = 16  # simulated streets for the loss
    calibration: Path | None = None  # own sequence for the ranges instead
    threads: int = 2
    limit: float = LIMIT  # percentage points of IoU


@dataclass(frozen=True)
class Quantised:
    """What came of it."""

    model: bytes  # ONNX
    floats: tuple[str, ...]  # layers that stay in float
    record: dict[str, Any]  # for the manifest


def quantise(
    network: nn.Module,
    float_model: bytes,
    sensor: RangeImage,
    residual: Residual,
    threshold: float | None,
    trained: bool,
    settings: Settings,
) -> Quantised:
    """The image network in integers; `network` and `float_model` return probabilities and features.

    threshold: probability from which a pixel counts as moving; None: the most likely class.
    trained: whether an IoU means something; if not, only probabilities are compared and nothing is refused.

    Raises QuantisationError where more than the limit is lost, naming the layers that lose most; SequenceError or
    ScanError for calibration data that cannot be used. Warns (MosWarning) of data that look unlike the sensor.
    """
    if settings.calibration is None:
        images = [scene.image for scene in simulated(sensor, residual, CALIBRATION_STREETS, settings.streets)]
        source = f"{settings.streets} simulated streets from {CALIBRATION_STREETS}"
    else:
        images = recorded(settings.calibration, sensor, residual)
        source = f"{len(images)} scans of {settings.calibration.resolve().name}"
    prepared = prepare(network, images[0].shape, images)
    scenes = simulated(sensor, residual, JUDGING_STREETS, settings.judging)
    judge = Judge(float_model, scenes, threshold, settings.threads)
    balance = Balance(float_model, images, settings.threads)

    @cache
    def lacking(floats: tuple[str, ...]) -> float:
        return balance.lacking(prepared.model(floats))

    def finished(floats: tuple[str, ...]) -> bytes:
        return prepared.model(floats, lacking(floats))

    floats = choose_floats(prepared, judge, settings.limit, finished) if trained else ()
    model = finished(floats)
    loss = judge.loss(model)
    record: dict[str, Any] = {
        "calibration": source,
        "judged_on": f"{settings.judging} simulated streets from {JUDGING_STREETS}, pixels",
        "added_to_moving_logit": lacking(floats),
        "probability_difference": float(f"{loss.difference:.2g}"),
        "float_layers": list(floats),
        "integer_layers": len(prepared.layers) - len(floats),
    }
    if trained:
        scores = {"iou_float": loss.before, "iou_int8": loss.after, "limit": settings.limit}
        record |= {key: round(value, 2) for key, value in scores.items()}
    else:
        record["note"] = "untrained weights: only probabilities are compared"
    return Quantised(model, floats, record)


def choose_floats(
    prepared: Prepared, judge: "Judge", limit: float, finished: Callable[[tuple[str, ...]], bytes]
) -> tuple[str, ...]:
    """The fewest layers whose arithmetic has to stay in float, in the order of what they lose alone.

    finished: the model with the given layers in float, as it would be written.
    """
    loss = judge.loss(finished(()))
    if loss.points <= limit:
        return ()
    every = list(prepared.layers)
    few = judge.quick()
    alone = {layer: few.loss(prepared.model([o for o in every if o != layer])).difference for layer in every}
    worst = sorted(every, key=lambda layer: (-alone[layer], layer))
    most = max(1, int(MOST_FLOAT * len(every)))
    for count in range(1, most + 1):
        floats = tuple(worst[:count])
        loss = judge.loss(finished(floats))
        if loss.points <= limit:
            return floats
    lines = ", ".join(f"{layer} ({alone[layer]:.1e})" for layer in worst[:5])
    raise QuantisationError(
        f"INT8 loses {loss.points:.2f} points of IoU (float {loss.before:.2f} %, limit {limit:g}), with {most} of "
        f"{len(every)} layers in float too. These lose most (mean difference of the probability alone): {lines}. "
        "Nothing was written; train longer, or export without --precision int8"
    )


class Balance:
    """Keeps the mean probability of moving on `images` (1, channels, H, W) what it is in float.

    What integers and ReLUs lose moves the logits to one side, and with them the points above a threshold.
    """

    def __init__(self, float_model: bytes, images: Sequence[np.ndarray], threads: int) -> None:
        self.images, self.threads = images, threads
        self.wanted = float(self._probabilities(float_model).mean())

    def lacking(self, model: bytes) -> float:
        """What to add to the logit of moving that `model` computes, at most LARGEST_SHIFT up or down; two digits."""
        odds = logit(self._probabilities(model))

        def excess(shift: float) -> float:
            return float(expit(odds + shift).mean()) - self.wanted

        if excess(-LARGEST_SHIFT) >= 0 or excess(LARGEST_SHIFT) <= 0:
            return -LARGEST_SHIFT if excess(0) > 0 else LARGEST_SHIFT
        return round(float(brentq(excess, -LARGEST_SHIFT, LARGEST_SHIFT, xtol=1e-3)), 2)

    def _probabilities(self, model: bytes) -> np.ndarray:
        run = session(model, self.threads)
        found = np.concatenate([run(image)[MOVING].ravel() for image in self.images])
        return found.astype(np.float64).clip(LEAST, 1 - LEAST)


class Loss(NamedTuple):
    """INT8 against float."""

    before: float  # % IoU of the moving class in float
    after: float  # % in INT8
    difference: float  # mean |difference| of the probability of moving over labelled pixels

    @property
    def points(self) -> float:
        """Percentage points of IoU lost."""
        return self.before - self.after


class Judge:
    """Compares models with the float one on the same scenes."""

    def __init__(self, float_model: bytes, scenes: Sequence[Scene], threshold: float | None, threads: int) -> None:
        self.float_model, self.scenes, self.threshold, self.threads = float_model, scenes, threshold, threads

    def quick(self) -> "Judge":
        """The same on few scenes."""
        return Judge(self.float_model, self.scenes[:QUICK], self.threshold, self.threads)

    def loss(self, model: bytes) -> Loss:
        """What `model` loses."""
        run = session(model, self.threads)
        before, after, differences = Confusion(), Confusion(), []
        for scene, want in zip(self.scenes, self._wanted, strict=True):
            got = run(scene.image)
            before.add(scene.labels, pixel_classes(want, self.threshold))
            after.add(scene.labels, pixel_classes(got, self.threshold))
            differences.append(np.abs(got[MOVING] - want[MOVING])[scene.labels != UNLABELLED].mean())
        return Loss(_percent(before.iou), _percent(after.iou), float(np.mean(differences)))

    @cached_property
    def _wanted(self) -> list[np.ndarray]:
        run = session(self.float_model, self.threads)
        return [run(scene.image) for scene in self.scenes]


def _percent(share: float) -> float:
    return 0.0 if np.isnan(share) else 100 * share


def session(model: bytes, threads: int) -> Callable[[np.ndarray], np.ndarray]:
    """Probabilities (3, H, W) of an image (1, channels, H, W)."""
    loaded = open_session(model, threads=threads)
    return lambda image: loaded.run(["probabilities"], {"image": image})[0][0]


def simulated(sensor: RangeImage, residual: Residual, first: int, count: int) -> list[Scene]:
    """Two scans of each of `count` simulated streets."""
    streets = SimulatedStreets(SampleConfig(sensor, residual), frames=2, every=4, first_street=first)
    return [Scene(sample.image[None], sample.labels) for number in range(count) for sample in streets.group(number)]


def recorded(folder: Path, sensor: RangeImage, residual: Residual, count: int = 16) -> list[np.ndarray]:
    """Images (1, channels, H, W) of `count` scans with a full history, spread over the sequence in `folder`.

    Raises SequenceError or ScanError where it cannot be used; warns of what does not look like the sensor.
    """
    sequence = open_sequence(folder)
    if len(sequence) <= HISTORY:
        raise SequenceError(f"{folder}: has {len(sequence)} scans; calibration needs at least {HISTORY + 1}")
    chosen = np.unique(np.linspace(HISTORY, len(sequence) - 1, count).round().astype(int))
    samples = Samples.of([sequence.read(int(i))[0] for i in chosen])
    findings = check_points(samples) + check_sensor(samples, sensor)
    for finding in sorted(findings, key=lambda finding: finding.level):  # bad, ok, warn
        text = f"{folder}: calibration data: {finding.topic}: {finding.text}"
        if finding.level == "bad":
            raise ScanError(f"{text}. Calibrate with scans that fit, or leave --calibration out")
        if finding.level == "warn":
            warnings.warn(text, MosWarning, stacklevel=2)
    builder = InputBuilder(sensor, residual, Workers(1))
    images = []
    for index in chosen:
        scans, poses = zip(*(sequence.read(int(i)) for i in range(index, index - HISTORY - 1, -1)), strict=True)
        relative = [np.linalg.inv(poses[0]) @ pose for pose in poses[1:]]
        images.append(builder.build(scans[0], scans[1:], relative).image[None].copy())
    if not any(image[:, 5:].any() for image in images):
        warnings.warn(f"{folder}: calibration data: no residual image shows anything", MosWarning, stacklevel=2)
    return images

"""INT8 export: calibrate, write, measure what it costs, and leave in float what does not bear it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from torch import nn

from export.graph.any_size import any_size
from export.int8.judge import Balance, Judge
from export.int8.prepare import Prepared, prepare
from export.int8.scenes import CALIBRATION_STREETS, JUDGING_STREETS, recorded, simulated
from mos_model.data.dataset import SampleConfig
from runtime.errors import QuantisationError

LIMIT = 0.5  # percentage points of IoU of the moving class that may be lost
MOST_FLOAT = 0.25  # share of the layers that may stay in float
SEVERAL = 3  # times as many streets where a network is for several sensors


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
    samples: SampleConfig,
    threshold: float | None,
    trained: bool,
    settings: Settings,
) -> Quantised:
    """The image network in integers; `network` and `float_model` return probabilities and features.

    samples: how the network sees scans of its sensor, of which streets are simulated.
    threshold: probability from which a pixel counts as moving; None: the most likely class.
    trained: whether an IoU means something; if not, only probabilities are compared and nothing is refused.

    Raises QuantisationError where more than the limit is lost, naming the layers that lose most; SequenceError for
    calibration data that cannot be used. Warns (MosWarning) of data that look unlike the sensor.
    """
    many = SEVERAL if samples.other_sensors else 1
    if settings.calibration is None:
        images = [scene.image for scene in simulated(samples, CALIBRATION_STREETS, many * settings.streets)]
        source = f"{many * settings.streets} simulated streets from {CALIBRATION_STREETS}"
    else:
        images = recorded(settings.calibration, samples)
        source = f"{len(images)} scans of {settings.calibration.resolve().name}"
    prepared = prepare(network, any_size(images[0].shape[1]), images)
    scenes = simulated(samples, JUDGING_STREETS, many * settings.judging)
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
        "judged_on": f"{many * settings.judging} simulated streets from {JUDGING_STREETS}, pixels",
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
    prepared: Prepared, judge: Judge, limit: float, finished: Callable[[tuple[str, ...]], bytes]
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
        "Nothing was written; train longer, or leave it in float (`precision='float32'`)"
    )

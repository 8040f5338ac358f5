"""Whether a checkpoint may be the start of a run, or what it goes on from."""

from dataclasses import replace
from typing import Any

from mos_model.networks.checkpoint import Stored
from mos_model.networks.config import ModelConfig, differences
from mos_model.training.distributed import Ranks
from mos_model.training.recipe import TrainConfig
from runtime.errors import CheckpointError

# Settings that may change on resuming.
FREE = {"steps", "validate_every", "validation_streets", "validation_frames", "precision"}


def check_start(start: Stored, model: ModelConfig) -> None:
    """Refuse a checkpoint of another image network. Name, sensors, range image, limits of residuals and point head may
    differ."""
    limits = {name: getattr(model.residual, name) for name in ("min_range", "max_range")}
    its = replace(start.config, residual=replace(start.config.residual, **limits))
    if found := differences(its, model, ignored=("name", "sensor", "other_sensors", "range_image", "point_head")):
        raise CheckpointError(
            f"{start.path}: of another network (its own against the one to train): {'; '.join(found)}"
        )


def check_resumable(previous: Stored, model: ModelConfig, config: TrainConfig, ranks: Ranks) -> None:
    """Refuse to go on with other settings than those that the run began with."""
    training = previous.training
    if "resume" not in training:
        raise CheckpointError(f"{previous.path}: was not written by training, so there is nothing to go on from")
    expected = model if config.stage == 2 else replace(model, point_head=None)
    problems = differences(previous.config, expected)
    before, now = _flat(training["config"]), _flat(config.to_dict())
    problems += [
        f"{key}: {before[key]!r} against {now.get(key)!r}"
        for key in before
        if key not in FREE and before[key] != now.get(key)
    ]
    if training["world"] != ranks.world:
        problems.append(f"processes: {training['world']} against {ranks.world}")
    if problems:
        raise CheckpointError(
            f"{previous.path}: of a run with other settings (its own against those given): {'; '.join(problems)}. "
            "Repeat its settings to resume it, or start anew from its weights (`init`)"
        )


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """Nested settings with their names joined by dots."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        inner = _flat(value) if isinstance(value, dict) else {}
        flat |= {f"{name}.{key}": item for key, item in inner.items()} if inner else {name: value}
    return flat

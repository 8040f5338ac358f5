"""Checkpoints: tensors and plain values in one file that is whole or absent.

{"format": 1, "config": ModelConfig.to_dict(), "image_net": state dict, "point_head": state dict (or absent),
"training": plain values and tensors}. Loading executes nothing (`weights_only=True`).
"""

import io
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from mos_model.networks.config import ModelConfig, differing_fields
from mos_model.networks.network import build_image_network, build_point_head
from runtime.errors import CheckpointError, SettingError
from runtime.files import write_whole

FORMAT = 1


@dataclass(frozen=True)
class Checkpoint:
    """What a checkpoint holds; modules in float32, on the CPU and in evaluation mode."""

    config: ModelConfig
    image_net: nn.Module
    point_head: nn.Module | None
    training: dict[str, Any]  # whatever the trainer stored: step, recipe, scores, optimizer state, ...


def save(
    path: str | os.PathLike[str],
    config: ModelConfig,
    image_net: nn.Module,
    point_head: nn.Module | None = None,
    training: Mapping[str, Any] | None = None,
    half: bool = False,
) -> None:
    """Write a checkpoint; where that fails, what lay at `path` before is whole (raises OutputError).

    `half` stores the weights (not `training`) as float16, but for tensors with values beyond its range. Raises
    CheckpointError where the modules do not fit `config`, or a value is no tensor and not plain.
    """
    if (point_head is None) != (config.point_head is None):
        raise CheckpointError(f"{path}: the configuration has {'a' if config.point_head else 'no'} point head")
    content: dict[str, Any] = {
        "format": FORMAT,
        "config": config.to_dict(),
        "image_net": _weights(image_net, half),
        "training": dict(training or {}),
    }
    if point_head is not None:
        content["point_head"] = _weights(point_head, half)
    _check_plain(content["training"], "training")
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_whole(path, buffer.getbuffer())


def load(path: str | os.PathLike[str], config: ModelConfig | None = None) -> Checkpoint:
    """Read a checkpoint of `save`. Raises CheckpointError where it is none, or not of `config` if given."""
    content = read(path)
    try:
        found = ModelConfig.from_dict(content["config"])
    except SettingError as error:
        raise CheckpointError(f"{path}: its configuration does not fit this version: {error}") from error
    if config is not None and found != config:
        lines = "; ".join(differing_fields(found, config))
        raise CheckpointError(f"{path}: made for another configuration (its own against the one asked for): {lines}")
    image_net, point_head = build_image_network(found), build_point_head(found)
    load_state(image_net, content["image_net"], f"{path}: image network")
    if point_head is not None:
        load_state(point_head, content.get("point_head", {}), f"{path}: point head")
        point_head.eval()
    elif "point_head" in content:
        raise CheckpointError(f"{path}: holds a point head that its configuration does not have")
    return Checkpoint(found, image_net.eval(), point_head, content["training"])


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The content of a checkpoint as it was stored, its format checked but no module built."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such checkpoint") from error
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        reason = str(error).split("\n", 1)[0]
        raise CheckpointError(f"{path}: not a checkpoint of tensors and plain values ({reason})") from error
    if not isinstance(content, dict) or not {"format", "config", "image_net", "training"} <= content.keys():
        raise CheckpointError(f"{path}: not a checkpoint of this package (published ones: see `mos export`)")
    if content["format"] != FORMAT:
        raise CheckpointError(f"{path}: format {content['format']!r}, but this version reads format {FORMAT}")
    return content


def load_state(
    module: nn.Module, state: Mapping[str, Any], what: str, unused_prefixes: tuple[str, ...] = ()
) -> list[str]:
    """Load `state` into `module` (casting to its dtypes) and return the keys dropped by `unused_prefixes`.

    Raises CheckpointError that names every missing, extra, misshapen and non-finite tensor of `what`; the
    module is then as it was.
    """
    if not isinstance(state, Mapping):
        raise CheckpointError(f"{what}: expected a mapping of tensors, not {type(state).__name__}")
    dropped = [key for key in state if key.startswith(unused_prefixes)] if unused_prefixes else []
    given = {key: value for key, value in state.items() if key not in set(dropped)}
    own = module.state_dict()
    problems = [f"{key} is missing" for key in own if key not in given]
    problems += [f"{key} is not part of the network" for key in given if key not in own]
    for key in own.keys() & given.keys():
        value = given[key]
        if not isinstance(value, Tensor):
            problems.append(f"{key} is no tensor")
        elif value.shape != own[key].shape:
            problems.append(f"{key} is {tuple(value.shape)} instead of {tuple(own[key].shape)}")
        elif not value.isfinite().all():
            problems.append(f"{key} is not finite")
    if problems:
        raise CheckpointError(f"{what} does not fit the network: {'; '.join(problems)}")
    module.load_state_dict(given)
    return dropped


def _weights(module: nn.Module, half: bool) -> dict[str, Tensor]:
    weights = {key: value.detach().cpu().contiguous() for key, value in module.state_dict().items()}
    if not half:
        return weights
    return {key: _as_half(value) for key, value in weights.items()}


def _as_half(value: Tensor) -> Tensor:
    """The tensor in half precision, or as it is where that has no numbers so large."""
    half = value.half() if value.is_floating_point() else value
    return half if torch.equal(half.isfinite(), value.isfinite()) else value


def _check_plain(value: Any, where: str) -> None:
    """Refuse now what `weights_only=True` would refuse at loading (a NumPy scalar, for example)."""
    if isinstance(value, dict):
        for key, item in value.items():
            _check_plain(key, f"{where} key {key!r}")
            _check_plain(item, f"{where}.{key}")
    elif type(value) in (list, tuple):
        for i, item in enumerate(value):
            _check_plain(item, f"{where}[{i}]")
    elif value is not None and type(value) not in (bool, int, float, str) and not isinstance(value, Tensor):
        raise CheckpointError(f"{where} is a {type(value).__name__}: store tensors and plain values only")

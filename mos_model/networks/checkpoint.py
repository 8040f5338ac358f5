"""Checkpoints: tensors and plain values in one file that is whole or absent.

{"format": 2, "config": ModelConfig.to_dict(), "image_net": state dict, "point_head": state dict (or absent),
"training": plain values and tensors}. Loading executes nothing (`weights_only=True`). `format_1.py` says how
older checkpoints differ.
"""

import io
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from mos_model.networks.config import ModelConfig, differences
from mos_model.networks.format_1 import renamed
from mos_model.networks.point_head import PointHead
from mos_model.networks.registry import read_config
from runtime.errors import CheckpointError, SettingError
from runtime.files import open_ordinary, write_whole

FORMAT = 2


@dataclass(frozen=True)
class Checkpoint:
    """What a checkpoint holds; modules in float32, on the CPU and in evaluation mode."""

    config: ModelConfig
    image_net: nn.Module
    point_head: PointHead | None
    training: dict[str, Any]  # whatever the trainer stored: step, recipe, scores, optimizer state, ...


@dataclass(frozen=True)
class Stored:
    """The same before any module is built."""

    path: str
    config: ModelConfig
    image_net: Mapping[str, Any]  # state dict
    point_head: Mapping[str, Any] | None  # state dict
    training: dict[str, Any]

    def image_network(self) -> nn.Module:
        """The image network, in evaluation mode. Raises CheckpointError where the tensors are not its own."""
        network = self.config.build_image_network()
        load_state(network, self.image_net, f"{self.path}: image network")
        return network.eval()

    def modules(self) -> Checkpoint:
        """All of it. Raises CheckpointError where the tensors are not those of the modules."""
        image_net, point_head = self.image_network(), self.config.build_point_head()
        if point_head is not None:
            load_state(point_head, self.point_head or {}, f"{self.path}: point head")
            point_head.eval()
        return Checkpoint(self.config, image_net, point_head, self.training)


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
    write_whole(os.fspath(path), buffer.getbuffer())


def load(path: str | Path, config: ModelConfig | None = None) -> Checkpoint:
    """Read a checkpoint of `save`. Raises CheckpointError where it is none, or not of `config` if given."""
    stored = read(path)
    if config is not None and stored.config != config:
        lines = "; ".join(differences(stored.config, config))
        raise CheckpointError(f"{path}: made for another configuration (its own against the one asked for): {lines}")
    return stored.modules()


def read(path: str | Path) -> Stored:
    """A checkpoint as it lies in its file. Raises CheckpointError where it is none."""
    try:
        with open_ordinary(path) as file:
            content = torch.load(file, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such checkpoint") from error
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        reason = str(error).split("\n", 1)[0]
        raise CheckpointError(f"{path}: not a checkpoint of tensors and plain values ({reason})") from error
    if not is_ours(content):
        raise CheckpointError(f"{path}: not a checkpoint of this package (published ones: see `mos export`)")
    return parse(content, str(path))


def is_ours(content: Any) -> bool:
    """Whether what a file holds is a checkpoint of `save`, and no published one."""
    return isinstance(content, dict) and {"format", "config", "image_net", "training"} <= content.keys()


def parse(content: dict[str, Any], path: str) -> Stored:
    """A checkpoint from the content of its file, of any format that there was. Raises CheckpointError."""
    if content["format"] not in (1, FORMAT):
        raise CheckpointError(f"{path}: format {content['format']!r}, but this version reads formats 1 to {FORMAT}")
    if not isinstance(content["training"], dict):
        raise CheckpointError(f"{path}: what it says of its training is a {type(content['training']).__name__}")
    try:
        config = read_config(content["config"])
    except SettingError as error:
        raise CheckpointError(f"{path}: its configuration does not fit this version: {error}") from error
    if "point_head" in content and config.point_head is None:
        raise CheckpointError(f"{path}: holds a point head that its configuration does not have")
    if content["format"] == 1:
        content = renamed(content, config, path)
    return Stored(path, config, content["image_net"], content.get("point_head"), content["training"])


def load_state(module: nn.Module, state: Any, what: str, names: Mapping[str, str] | None = None) -> None:
    """Load `state` into `module`, casting to its dtypes. names: what `state` calls each tensor; None: as the module.

    Raises CheckpointError that names every missing, extra, misshapen and non-finite tensor of `what`; the
    module is then as it was.
    """
    if not isinstance(state, Mapping):
        raise CheckpointError(f"{what}: expected a mapping of tensors, not {type(state).__name__}")
    own = module.state_dict()
    names = {key: key for key in own} if names is None else names
    known = set(names.values())
    problems = [f"{name} is missing" for name in names.values() if name not in state]
    problems += [f"{name} is not part of the network" for name in state if name not in known]
    for key, name in names.items():
        value = state.get(name)
        if name not in state:
            continue
        if not isinstance(value, Tensor):
            problems.append(f"{name} is no tensor")
        elif value.layout != torch.strided or value.is_complex() or value.is_quantized or value.is_meta:
            problems.append(f"{name} is no tensor of plain numbers")
        elif value.shape != own[key].shape:
            problems.append(f"{name} is {tuple(value.shape)} instead of {tuple(own[key].shape)}")
        elif not value.isfinite().all():
            problems.append(f"{name} is not finite")
    if problems:
        raise CheckpointError(f"{what} does not fit the network: {'; '.join(problems)}")
    module.load_state_dict({key: state[name] for key, name in names.items()})


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

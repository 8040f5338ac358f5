"""What checkpoints of format 1, told by that number, hold otherwise than today's.

One flat configuration had the settings of every kind of network. Tensors had other names; the modules were made in the
order of today, so the place of a tensor in its state dict says which one it is.
"""

from collections.abc import Mapping
from typing import Any

import torch

from mos_model.networks.config import ModelConfig
from runtime.errors import CheckpointError
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import DEFAULT_SENSOR, name_of
from runtime.typed_json import build

RENAMED = {"network": "kind", "rt_widths": "widths"}  # settings


def from_flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a configuration under their names of today.

    The flat form, told by `network`, had `pooling`, `meta_kernel` and `rt_widths` for every kind. Where a kind does not
    have them they said nothing, or (False, ()) that it does not. `rt_widths` = () stood for the default. `sensor` was
    the range image; which sensor it shows was not said. Raises SettingError where it is none.
    """
    settings = dict(values)
    flat = "network" in settings
    for before, now in RENAMED.items():
        if before in settings:
            settings[now] = settings.pop(before)
    if isinstance(settings.get("sensor"), Mapping):
        settings["range_image"] = settings.pop("sensor")
        image = build(RangeImage, settings["range_image"], "model: sensor")
        settings["sensor"] = name_of(image) or DEFAULT_SENSOR
    kind = settings.get("kind")
    if flat and kind == "rt":
        settings.pop("pooling", None)
    if kind != "dual" and settings.get("meta_kernel") is False:
        del settings["meta_kernel"]
    if settings.get("widths") in ((), []):
        del settings["widths"]
    return settings


def renamed(content: dict[str, Any], config: ModelConfig, what: str) -> dict[str, Any]:
    """A checkpoint of `config` with its tensors under their names of today.

    Raises CheckpointError where they are not those of the network.
    """
    with torch.device("meta"):
        image_net, point_head = config.build_image_network(), config.build_point_head()
    content = dict(content)
    names = list(image_net.state_dict())
    content["image_net"] = _by_place(content["image_net"], names, f"{what}: image network")
    trained = names
    if point_head is not None and "point_head" in content:
        trained = list(point_head.state_dict())
        content["point_head"] = _by_place(content["point_head"], trained, f"{what}: point head")
    resume = content["training"].get("resume")
    if resume:
        if not isinstance(resume, dict):
            raise CheckpointError(f"{what}: what a training goes on from is a {type(resume).__name__}")
        states = {key: _by_place(resume[key], trained, what) for key in ("module", "average") if resume.get(key)}
        content["training"] = content["training"] | {"resume": resume | states}
    return content


def _by_place(state: Any, names: list[str], what: str) -> dict[str, Any]:
    """`state` under other names, one after the other; each must be of the same kind (weight, bias, ...)."""
    if not isinstance(state, Mapping) or [_last(name) for name in state] != [_last(name) for name in names]:
        raise CheckpointError(f"{what}: its tensors are not those of the network that its configuration speaks of")
    return dict(zip(names, state.values(), strict=True))


def _last(name: str) -> str:
    return str(name).rpartition(".")[2]

"""The networks: a new one is a file of its own and a line here."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from mos_model.networks.config import ModelConfig
from mos_model.networks.cylinder3d import Cylinder3DConfig
from mos_model.networks.dual import DualConfig
from mos_model.networks.format_1 import from_flat
from mos_model.networks.limoseg import LiMoSegConfig
from mos_model.networks.lmnet import LMNetConfig
from mos_model.networks.rt import RealtimeConfig
from runtime.errors import SettingError
from runtime.typed_json import build

NETWORKS: dict[str, type[ModelConfig]] = {
    network.kind: network
    for network in (
        LMNetConfig,
        DualConfig,
        RealtimeConfig,
        LiMoSegConfig,
        Cylinder3DConfig,
    )
}


def names() -> list[str]:
    """The names for `named_config`."""
    return [name for network in NETWORKS.values() for name in network.named]


def named_config(name: str, /, channels: int = 32, **changes: Any) -> ModelConfig:
    """A configuration by its name, at any width; `changes` are other fields of it.

    The point head takes the image network's features, so its `in_channels` follows `channels`. Raises SettingError on
    an unknown name or field.
    """
    found = next((network for network in NETWORKS.values() if name in network.named), None)
    if found is None:
        raise SettingError(f"no network is called {name!r}; there are {', '.join(names())}")
    if unknown := sorted(changes.keys() - {f.name for f in fields(found)}):
        raise SettingError(f"network {name!r} has no setting {', '.join(unknown)}")
    settings: dict[str, Any] = {"name": name, "channels": channels, **found.named[name], **changes}
    if settings.get("point_head") is not None:
        settings["point_head"] = replace(settings["point_head"], in_channels=channels)
    return found(**settings)


def read_config(values: Any) -> ModelConfig:
    """Inverse of `ModelConfig.to_dict`; a missing key takes its default. Reads the flat form of format 1 too.

    Raises SettingError on an unknown key or kind, and on a value that is not of its type.
    """
    if not isinstance(values, Mapping):
        raise SettingError(f"model: expected a mapping of settings, not {type(values).__name__}")
    settings = from_flat(values)
    kind = settings.pop("kind", DualConfig.kind)
    if not isinstance(kind, str) or kind not in NETWORKS:
        raise SettingError(f"the kind of a network must be one of {', '.join(NETWORKS)}, not {kind!r}")
    return build(NETWORKS[kind], settings, "model")

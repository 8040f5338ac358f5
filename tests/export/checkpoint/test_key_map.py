"""The map from our names to the published ones, against the layout of the published files."""

import re
from dataclasses import replace

import pytest
import torch

from export.checkpoint.key_map import (
    UNUSED_PREFIXES,
    head_modules,
    image_modules,
    published_names,
    under_our_names,
)
from mos_model.networks.point_head import PointHead
from mos_model.networks.registry import named_config
from runtime.bundle.head_shape import FULL, LITE, PointHeadConfig
from tests.support.paths import ROOT
from tests.support.published import layout


def shapes(network: torch.nn.Module, modules: dict[str, str]) -> dict[str, tuple[int, ...]]:
    """Of the tensors, under the published names."""
    state = network.state_dict()
    names = published_names(state, modules)
    return {names[key]: tuple(value.shape) for key, value in state.items()}


@pytest.mark.parametrize(("name", "network"), [("v1", "image_net"), ("lmnet", "lmnet")])
def test_image_networks(name: str, network: str) -> None:
    config = named_config(name)
    with torch.device("meta"):
        found = shapes(config.build_image_network(), image_modules(config.kind))
    assert found == {key: shape for key, shape in layout(network).items() if not key.startswith(UNUSED_PREFIXES)}


@pytest.mark.parametrize(("name", "config"), [("full", FULL), ("lite", LITE)])
def test_point_heads(name: str, config: PointHeadConfig) -> None:
    with torch.device("meta"):
        found = shapes(PointHead(config), head_modules(config))
    assert found == layout(f"point_head_{name}")


@pytest.mark.parametrize("config", [FULL, LITE, replace(LITE, in_channels=64, up=(64, 96))])
def test_there_and_back(config: PointHeadConfig) -> None:
    with torch.device("meta"):
        keys = list(PointHead(config).state_dict())
    names = published_names(keys, head_modules(config))
    assert len(set(names.values())) == len(keys)
    assert under_our_names({name: key for key, name in names.items()}, head_modules(config)) == {k: k for k in keys}


def test_unused_prefixes_all_occur() -> None:
    keys = layout("image_net")
    assert all(any(key.startswith(prefix) for key in keys) for prefix in UNUSED_PREFIXES)


def test_published_names_are_known_here_alone() -> None:
    """Nowhere in the product but in `export/checkpoint`."""
    words = re.compile(r"downCntx|[rR]esBlock\d|upBlock\d|metaConv|conv1x1|logits3|\bRI_|net\.[0134]\b|downsample\.")
    files = [path for part in ("runtime", "mos_model", "export") for path in (ROOT / part).rglob("*.py")]
    found = {str(path.relative_to(ROOT)) for path in files if words.search(path.read_text())}
    assert found == {"export/checkpoint/key_map.py", "export/checkpoint/published.py"}

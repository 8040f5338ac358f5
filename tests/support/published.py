"""The published network's layout, reference weights and reference outputs."""

import importlib.util
import json
from types import ModuleType

import numpy as np
import torch
from torch import Tensor, nn

from export.checkpoint.key_map import head_modules, image_modules, under_our_names
from mos_model.networks.point_head import PointHead
from mos_model.networks.registry import named_config
from runtime.bundle.head_shape import FULL, LITE
from tests.support.paths import PUBLISHED


def layout(network: str) -> dict[str, tuple[int, ...]]:
    """Keys and shapes of a published checkpoint."""
    entries = json.loads((PUBLISHED / "layout.json").read_text())[network]
    return {key: tuple(shape) for key, shape in entries.items()}


def reference_state(network: str, seed: int = 2026) -> dict[str, Tensor]:
    """Random but reproducible weights under the published keys."""
    arrays = _reference_weights().reference_state_dict(network, seed)
    return {key: torch.from_numpy(np.asarray(value)) for key, value in arrays.items()}


def reference_network(layout_name: str, seed: int = 2026) -> nn.Module:
    """A published image network ("image_net", "lmnet") with the reference weights, in evaluation mode."""
    config = named_config({"image_net": "v1", "lmnet": "lmnet"}[layout_name])
    network = config.build_image_network()
    network.load_state_dict(under_our_names(reference_state(layout_name, seed), image_modules(config.kind)))
    return network.eval()


def reference_head(name: str, seed: int = 2026) -> PointHead:
    """A published point head ("full", "lite") with the reference weights, in evaluation mode."""
    config = {"full": FULL, "lite": LITE}[name]
    head = PointHead(config)
    head.load_state_dict(under_our_names(reference_state(f"point_head_{name}", seed), head_modules(config)))
    return head.eval()


def reference_output(name: str) -> dict[str, Tensor]:
    """What the published network computes with the reference weights of seed 2026."""
    with np.load(PUBLISHED / f"{name}.npz") as file:
        return {key: torch.from_numpy(file[key]) for key in file.files}


def _reference_weights() -> ModuleType:
    spec = importlib.util.spec_from_file_location("reference_weights", PUBLISHED / "reference_weights.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

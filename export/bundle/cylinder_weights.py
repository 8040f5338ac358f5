"""The weights of Cylinder3D as a bundle holds them: BatchNorms that follow a product directly are folded into it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from export.bundle.head_weights import EPSILON
from runtime.errors import CheckpointError
from runtime.head.cylinder.cylinder_layers import CellLayer, cylinder_layers

State = dict[str, NDArray[np.float64]]


def cylinder_arrays(network: nn.Module, width: int, half: bool) -> dict[str, NDArray[Any]]:
    """What `cylinder_net.npz` holds: the weights of `cylinder_layers(width)`.

    `half`: kernels into which nothing is folded are float16; so a checkpoint in half precision loses nothing. Raises
    CheckpointError where the network is not one of that width.
    """
    state: State = {key: value.detach().double().numpy() for key, value in network.state_dict().items()}
    arrays: dict[str, NDArray[Any]] = {}
    for layer in cylinder_layers(width):
        for name, value in _folded(layer, state).items():
            exact = half and layer.kernel and not layer.bias and name.endswith(".weight")
            arrays[name] = value.astype(np.float16 if exact else np.float32)
            if arrays[name].shape != layer.shapes()[name]:
                raise CheckpointError(f"not a Cylinder3D of {width} channels: {name} is {arrays[name].shape}")
    return arrays


def _folded(layer: CellLayer, state: State) -> State:
    """The weights of a layer, with the BatchNorms around it."""
    name = layer.name
    weight = state[f"{name}.kernel"] if layer.kernel else state[f"{name}.weight"].T
    if layer.after:
        return {f"{name}.weight": weight, f"{name}.after": np.stack(_norm(f"{name}.norm", state))}
    bias = state.get(f"{name}.bias", np.zeros(layer.outputs))
    if name == "points.0":  # the network normalises what it is given
        scale, shift = _norm("norm", state)
        weight, bias = scale[:, None] * weight, bias + shift @ weight
    behind = "refine.norm" if name.startswith("refine.") else f"{name}.norm"
    if f"{behind}.weight" in state:
        scale, shift = _norm(behind, state)
        weight, bias = weight * scale, bias * scale + shift
    return {f"{name}.weight": weight, **({f"{name}.bias": bias} if layer.bias else {})}


def _norm(name: str, state: State) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Scale and shift that a BatchNorm comes to."""
    scale = state[f"{name}.weight"] / np.sqrt(state[f"{name}.running_var"] + EPSILON)
    return scale, state[f"{name}.bias"] - state[f"{name}.running_mean"] * scale

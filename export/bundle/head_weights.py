"""The point head's weights as a bundle holds them: each BatchNorm folded into the layer before it.

Takes a state dict of `mos_model.networks.point_head.PointHead`, whose layers have the names of `runtime.head.weights`.
"""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.head_shape import PointHeadConfig
from runtime.errors import CheckpointError
from runtime.head.weights import Layer, Weights, layers

if TYPE_CHECKING:
    from torch import nn

EPSILON = 1e-5  # of every BatchNorm


def fold(weights: Mapping[str, NDArray[Any]], config: PointHeadConfig) -> Weights:
    """State dict -> per layer of `layers` `NAME.weight` (K, in, out) or (in, out) and `NAME.bias` (out,), float32.

    A shortcut's bias is part of its conv2's. Raises CheckpointError on a missing, extra or misshapen tensor.
    """
    left = {key: value for key, value in weights.items() if not key.endswith("num_batches_tracked")}
    wrong: list[str] = []

    def take(key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        value = left.pop(key, None)
        if value is None:
            wrong.append(f"{key} is missing")
        elif value.shape != shape:
            wrong.append(f"{key} is {value.shape}, not {shape}")
        else:
            return value.astype(np.float64)
        return np.ones(shape)

    folded: dict[str, NDArray[np.float64]] = {}
    for layer in layers(config):
        name, vector = layer.name, (layer.outputs,)
        if is_linear(layer):
            weight, bias = take(f"{name}.weight", layer.shape[::-1]).T, take(f"{name}.bias", vector)
        else:
            weight, bias = take(f"{name}.kernel", layer.shape), np.zeros(vector)
        if has_norm(layer):
            scale, shift = take(f"{name}.norm.weight", vector), take(f"{name}.norm.bias", vector)
            mean = take(f"{name}.norm.running_mean", vector)
            scale = scale / np.sqrt(take(f"{name}.norm.running_var", vector) + EPSILON)
            weight, bias = weight * scale, (bias - mean) * scale + shift
        folded[f"{name}.weight"] = weight
        if name.endswith("shortcut"):
            folded[name.replace("shortcut", "conv2.bias")] += bias
        else:
            folded[f"{name}.bias"] = bias
    wrong += [f"{key} is unknown" for key in left]
    if wrong:
        raise CheckpointError(f"not the weights of this point head: {'; '.join(wrong)}")
    return {key: np.ascontiguousarray(value, np.float32) for key, value in folded.items()}


def is_linear(layer: Layer) -> bool:
    """Whether the layer is dense, its `weight` (out, in) with a `bias`; the others have a `kernel` alone."""
    return layer.name.startswith(("point_transforms", "classifier"))


def has_norm(layer: Layer) -> bool:
    """Whether a BatchNorm follows."""
    return layer.name != "classifier"


def head_arrays(head: "nn.Module", config: PointHeadConfig, half: bool) -> dict[str, NDArray[Any]]:
    """What `point_head.npz` holds: what `fold` gives.

    `half`: kernels as they are in the checkpoint, in float16, each with the float32 scale of its BatchNorm beside it
    (`NAME.scale`); so a checkpoint in half precision loses nothing.
    """
    state = {key: value.detach().numpy() for key, value in head.state_dict().items()}
    arrays: dict[str, NDArray[Any]] = dict(fold(state, config))
    for layer in layers(config) if half else ():
        name, scale = layer.name, np.ones(layer.outputs)
        if has_norm(layer):
            variance = state[f"{name}.norm.running_var"].astype(np.float64)
            scale = state[f"{name}.norm.weight"] / np.sqrt(variance + EPSILON)
        kernel = state[f"{name}.weight"].T if is_linear(layer) else state[f"{name}.kernel"]
        arrays[f"{name}.weight"] = kernel.astype(np.float16)
        arrays[f"{name}.scale"] = scale.astype(np.float32)
    return arrays


def write_point_head(path: Path, head: "nn.Module", config: PointHeadConfig, half: bool) -> None:
    """Write `point_head.npz`; `half` as in `head_arrays`."""
    write_arrays(path, head_arrays(head, config, half))


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the weights of a bundle's `.npz` file, in the order of their names."""
    ordered: dict[str, Any] = {key: np.ascontiguousarray(arrays[key]) for key in sorted(arrays)}
    buffer = io.BytesIO()
    np.savez(buffer, **ordered)
    path.write_bytes(buffer.getbuffer())

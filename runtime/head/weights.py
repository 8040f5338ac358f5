"""Names and shapes of a point head's weights: as in published checkpoints, and folded for the runtime."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.head_shape import PointHeadConfig
from runtime.errors import BundleError, CheckpointError

EPSILON = 1e-5  # of every BatchNorm
Weights = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class Layer:
    """A convolution or linear layer, followed by a BatchNorm (the classifier: by none)."""

    name: str  # in the folded weights: name.weight and name.bias
    offsets: int  # of the kernel: 27, 8, or 1 for a dense layer
    inputs: tuple[int, ...]  # channels, of each part where the input is a concatenation
    outputs: int  # channels
    source: str  # of the weight, in a published checkpoint
    norm: str  # prefix of the BatchNorm there

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the folded weight: (K, in, out), or (in, out) for a dense layer."""
        dense = (sum(self.inputs), self.outputs)
        return dense if self.offsets == 1 else (self.offsets, *dense)

    @property
    def linear(self) -> bool:
        """Whether the published weight is that of a linear layer: (out, in), with a bias."""
        return self.source.endswith("weight")


def layers(config: PointHeadConfig) -> list[Layer]:
    """All layers of a point head."""
    width, depth = config.in_channels, len(config.down)
    found = [Layer("stem", 27, (width,), width, "stem.0.kernel", "stem.1")]

    def conv(name: str, offsets: int, inputs: tuple[int, ...], outputs: int, at: str, norm: str) -> None:
        found.append(Layer(name, offsets, inputs, outputs, f"{at}.kernel", norm))

    def residual(at: str, inputs: tuple[int, ...], outputs: int) -> None:
        conv(f"{at}.conv1", 27, inputs, outputs, f"{at}.net.0", f"{at}.net.1")
        conv(f"{at}.conv2", 27, (outputs,), outputs, f"{at}.net.3", f"{at}.net.4")
        if sum(inputs) != outputs:
            conv(f"{at}.shortcut", 1, inputs, outputs, f"{at}.downsample.0", f"{at}.downsample.1")

    for i, channels in enumerate(config.down, 1):
        conv(f"stage{i}.0", 8, (width,), width, f"stage{i}.0.net.0", f"stage{i}.0.net.1")
        residual(f"stage{i}.1", (width,), channels)
        residual(f"stage{i}.2", (channels,), channels)
        width = channels
    skips = [config.in_channels, *config.down]
    for i, channels in enumerate(config.up, 1):
        conv(f"up{i}.0", 8, (width,), channels, f"up{i}.0.net.0", f"up{i}.0.net.1")
        residual(f"up{i}.1.0", (channels, skips[depth - i]), channels)
        residual(f"up{i}.1.1", (channels,), channels)
        width = channels
    points = [config.in_channels, config.down[-1]]
    points += [config.up[config.fuse_after_up - 1]] if config.fuse_after_up else []
    points += [config.up[-1]]
    for i, (inputs, outputs) in enumerate(pairwise(points)):
        at = f"point_transforms.{i}"
        found.append(Layer(at, 1, (inputs,), outputs, f"{at}.0.weight", f"{at}.1"))
    found.append(Layer("classifier", 1, (config.up[-1],), 3, "classifier.0.weight", ""))
    return found


def fold(weights: Mapping[str, NDArray[np.generic]], config: PointHeadConfig) -> Weights:
    """Published state dict -> weights of `point_head.npz`: each BatchNorm folded into the layer before it.

    Per layer `NAME.weight` (K, in, out) or (in, out) and `NAME.bias` (out,), float32; names as in `layers`
    (`stageI.0`, `stageI.J.conv1`, `.conv2`, `.shortcut`, `upI.0`, `upI.1.J....`, `point_transforms.I`, ...).
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
        vector = (layer.outputs,)
        weight = take(layer.source, layer.shape[::-1] if layer.linear else layer.shape)
        weight = weight.T if layer.linear else weight
        bias = take(layer.source.replace("weight", "bias"), vector) if layer.linear else np.zeros(vector)
        if layer.norm:
            scale = take(f"{layer.norm}.weight", vector)
            shift = take(f"{layer.norm}.bias", vector)
            mean = take(f"{layer.norm}.running_mean", vector)
            scale = scale / np.sqrt(take(f"{layer.norm}.running_var", vector) + EPSILON)
            weight, bias = weight * scale, (bias - mean) * scale + shift
        folded[f"{layer.name}.weight"] = weight
        if layer.name.endswith("shortcut"):
            folded[layer.name.replace("shortcut", "conv2.bias")] += bias
        else:
            folded[f"{layer.name}.bias"] = bias
    wrong += [f"{key} is unknown" for key in left]
    if wrong:
        raise CheckpointError(f"not the weights of this point head: {'; '.join(wrong)}")
    return {key: np.ascontiguousarray(value, np.float32) for key, value in folded.items()}


def checked(weights: Mapping[str, NDArray[np.generic]], config: PointHeadConfig) -> Weights:
    """Folded weights (float16 or 32) as float32. Raises BundleError for missing, extra or misshapen ones."""
    shapes: dict[str, tuple[int, ...]] = {}
    for layer in layers(config):
        shapes[f"{layer.name}.weight"] = layer.shape
        if not layer.name.endswith("shortcut"):
            shapes[f"{layer.name}.bias"] = (layer.outputs,)
    wrong = [f"{key} is missing" for key in shapes if key not in weights]
    wrong += [f"{key} is unknown" for key in weights if key not in shapes]
    for key in shapes.keys() & weights.keys():
        if weights[key].shape != shapes[key] or weights[key].dtype.kind != "f":
            wrong.append(f"{key} is {weights[key].dtype} {weights[key].shape}, not floats of shape {shapes[key]}")
        elif not np.isfinite(weights[key]).all():
            wrong.append(f"{key} is not finite")
    if wrong:
        raise BundleError(f"the point head's weights do not fit its configuration: {'; '.join(sorted(wrong))}")
    return {key: weights[key].astype(np.float32) for key in shapes}

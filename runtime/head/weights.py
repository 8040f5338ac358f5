"""Names and shapes of a point head's weights, each BatchNorm folded into the layer before it."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.head_shape import PointHeadConfig
from runtime.errors import BundleError

Weights = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class Layer:
    """A convolution or dense layer."""

    name: str  # its weights are name.weight and name.bias; the bias of a shortcut is part of its conv2's
    offsets: int  # of the kernel: 27, 8, or 1 for a dense layer
    inputs: tuple[int, ...]  # channels, of each part where the input is a concatenation
    outputs: int  # channels

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the weight: (K, in, out), or (in, out) for a dense layer."""
        dense = (sum(self.inputs), self.outputs)
        return dense if self.offsets == 1 else (self.offsets, *dense)


def layers(config: PointHeadConfig) -> list[Layer]:
    """All layers of a point head: `stem`, `stageI.0` (down), `stageI.J.conv1`, `.conv2` and `.shortcut`, `upI.0`,
    `upI.1.J.conv1`, ..., `point_transforms.I`, `classifier`."""
    width, depth = config.in_channels, len(config.down)
    found = [Layer("stem", 27, (width,), width)]

    def residual(at: str, inputs: tuple[int, ...], outputs: int) -> None:
        found.append(Layer(f"{at}.conv1", 27, inputs, outputs))
        found.append(Layer(f"{at}.conv2", 27, (outputs,), outputs))
        if sum(inputs) != outputs:
            found.append(Layer(f"{at}.shortcut", 1, inputs, outputs))

    for i, channels in enumerate(config.down, 1):
        found.append(Layer(f"stage{i}.0", 8, (width,), width))
        residual(f"stage{i}.1", (width,), channels)
        residual(f"stage{i}.2", (channels,), channels)
        width = channels
    skips = [config.in_channels, *config.down]
    for i, channels in enumerate(config.up, 1):
        found.append(Layer(f"up{i}.0", 8, (width,), channels))
        residual(f"up{i}.1.0", (channels, skips[depth - i]), channels)
        residual(f"up{i}.1.1", (channels,), channels)
        width = channels
    points = [config.in_channels, config.down[-1]]
    points += [config.up[config.fuse_after_up - 1]] if config.fuse_after_up else []
    points += [config.up[-1]]
    found += [Layer(f"point_transforms.{i}", 1, (a,), b) for i, (a, b) in enumerate(pairwise(points))]
    found.append(Layer("classifier", 1, (config.up[-1],), 3))
    return found


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

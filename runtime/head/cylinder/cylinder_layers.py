"""Names and shapes of the weights of Cylinder3D; all widths follow from one, c (32 as published)."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.view import POINT_CHANNELS
from runtime.classes import CLASSES
from runtime.errors import BundleError
from runtime.head.cylinder.cells import KERNELS

ORDERS = (("1x3x3", "3x1x3"), ("3x1x3", "1x3x3"))  # of the kernels in the two branches of an asymmetric block
UP = ("1x3x3", "3x1x3", "3x3x3")  # behind a climb to the finer scale
AXES = ("3x1x1", "1x3x1", "1x1x3")  # of the context, one dimension each


@dataclass(frozen=True)
class CellLayer:
    """A convolution over cells, or a dense layer."""

    name: str
    kernel: str  # one of KERNELS, or "": dense
    inputs: tuple[int, ...]  # channels, of each part where the input is a concatenation
    outputs: int  # channels
    bias: bool = False  # of a dense layer, or of the BatchNorm that is folded into it
    after: bool = False  # LeakyReLU, then scale and shift of a BatchNorm

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of its weights in a file."""
        weight = (sum(self.inputs), self.outputs)
        found: dict[str, tuple[int, ...]] = {}
        found[f"{self.name}.weight"] = (len(KERNELS[self.kernel]), *weight) if self.kernel else weight
        if self.bias:
            found[f"{self.name}.bias"] = (self.outputs,)
        if self.after:
            found[f"{self.name}.after"] = (2, self.outputs)
        return found


def cylinder_layers(c: int) -> list[CellLayer]:
    """All layers: `points.I`, `compress`, `context.B.I`, `downN.block.B.I`, `downN.pool`, `upN.before`, `upN.climb`,
    `upN.block.I`, `axes.I`, `refine.cells`, `refine.points`, `classifier`."""
    widths = [POINT_CHANNELS, 2 * c, 4 * c, 8 * c, 8 * c]
    found = [CellLayer(f"points.{n}", "", (i,), o, bias=True) for n, (i, o) in enumerate(pairwise(widths))]
    found.append(CellLayer("compress", "", (8 * c,), c // 2, bias=True))

    def asymmetric(at: str, inputs: int, outputs: int) -> None:
        for branch, order in enumerate(ORDERS):
            for n, (kernel, i) in enumerate(zip(order, (inputs, outputs), strict=True)):
                found.append(CellLayer(f"{at}.{branch}.{n}", kernel, (i,), outputs, after=True))

    asymmetric("context", c // 2, c)
    downs = (c, 2 * c, 4 * c, 8 * c, 16 * c)
    for n, (i, o) in enumerate(pairwise(downs), 1):
        asymmetric(f"down{n}.block", i, o)
        found.append(CellLayer(f"down{n}.pool", "3x3x3", (o,), o))
    ups = (16 * c, 16 * c, 8 * c, 4 * c, 2 * c)
    for n, (i, o) in enumerate(pairwise(ups), 1):
        found.append(CellLayer(f"up{n}.before", "3x3x3", (i,), o, after=True))
        found.append(CellLayer(f"up{n}.climb", "3x3x3", (o,), o))
        for m, kernel in enumerate(UP):
            found.append(CellLayer(f"up{n}.block.{m}", kernel, (o,), o, after=True))
    found += [CellLayer(f"axes.{n}", kernel, (2 * c,), 2 * c, bias=True) for n, kernel in enumerate(AXES)]
    found.append(CellLayer("refine.cells", "", (2 * c, 2 * c), c))
    found.append(CellLayer("refine.points", "", (8 * c,), c, bias=True))
    found.append(CellLayer("classifier", "", (c,), len(CLASSES), bias=True))
    return found


def checked_cylinder(weights: Mapping[str, NDArray[np.generic]], c: int) -> dict[str, NDArray[np.float32]]:
    """Weights (float16 or 32) as float32. Raises BundleError for missing, extra or misshapen ones."""
    shapes = {name: shape for layer in cylinder_layers(c) for name, shape in layer.shapes().items()}
    wrong = [f"{name} is missing" for name in shapes if name not in weights]
    wrong += [f"{name} is unknown" for name in weights if name not in shapes]
    for name in shapes.keys() & weights.keys():
        value = weights[name]
        if value.shape != shapes[name] or value.dtype.kind != "f":
            wrong.append(f"{name} is {value.dtype} {value.shape}, not floats of shape {shapes[name]}")
        elif not np.isfinite(value).all():
            wrong.append(f"{name} is not finite")
    if wrong:
        raise BundleError(f"weights do not fit a Cylinder3D of {c} channels: {'; '.join(sorted(wrong)[:5])}")
    return {name: weights[name].astype(np.float32) for name in shapes}

"""What each ATen operation is in ONNX.

An emitter takes the tracer, the output's shape and the operation's arguments; it returns the name of the output.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from torch import Tensor

from export.graph.tracing import Emitter, Tracer
from runtime.errors import SettingError

Shape = tuple[int, ...]
LAST = np.iinfo(np.int64).max  # stands for the end of an axis, however long
EMITTERS: dict[str, Emitter] = {}  # by the name of the ATen operation


def emits(*ops: str) -> Callable[[Emitter], Emitter]:
    """Register the emitter of ATen operations."""

    def register(emitter: Emitter) -> Emitter:
        EMITTERS.update(dict.fromkeys(ops, emitter))
        return emitter

    return register


@emits("convolution")
def convolution(
    t: Tracer,
    shape: Shape,
    x: Tensor,
    weight: Tensor,
    bias: Tensor | None,
    stride: list[int],
    padding: list[int],
    dilation: list[int],
    transposed: bool,
    output_padding: list[int],
    groups: int,
) -> str:
    inputs = [t.name(x), t.name(weight)] + ([] if bias is None else [t.name(bias)])
    settings: dict[str, Any] = {
        "kernel_shape": list(weight.shape[2:]),
        "strides": list(stride),
        "pads": [*padding, *padding],
        "dilations": list(dilation),
        "group": groups,
    }
    if transposed:
        return t.graph.add("ConvTranspose", inputs, shape, output_padding=list(output_padding), **settings)
    return t.graph.add("Conv", inputs, shape, **settings)


@emits("native_batch_norm")
def batch_norm(
    t: Tracer,
    shape: Shape,
    x: Tensor,
    weight: Tensor,
    bias: Tensor,
    mean: Tensor,
    var: Tensor,
    training: bool,
    momentum: float,
    eps: float,
) -> str:
    """Stored as scale and shift alone: (x - 0) / sqrt(1 + 0) * scale + shift."""
    scale = t.data(weight) / np.sqrt(t.data(var) + eps)
    shift = t.data(bias) - t.data(mean) * scale
    parts = {"scale": scale, "shift": shift, "mean": np.zeros_like(scale), "var": np.ones_like(scale)}
    name = t.name(x)
    names = [t.graph.weight(f"{name}.{part}", values) for part, values in parts.items()]
    return t.graph.add("BatchNormalization", [name, *names], shape, epsilon=0.0)


@emits("leaky_relu")
def leaky_relu(t: Tracer, shape: Shape, x: Tensor, slope: float = 0.01) -> str:
    return t.graph.add("LeakyRelu", [t.name(x)], shape, alpha=slope)


def unary(op: str, *names: str) -> None:
    """Register operations of one tensor."""
    emits(*names)(lambda t, shape, x: t.graph.add(op, [t.name(x)], shape))


def binary(op: str, *names: str) -> None:
    """Register operations of two tensors, or of a tensor and a number."""

    def emit(t: Tracer, shape: Shape, a: Any, b: Any, alpha: float = 1) -> str:
        return t.graph.add(op, [operand(t, a), operand(t, b, alpha)], shape)

    emits(*names)(emit)


def operand(t: Tracer, value: Any, alpha: float = 1) -> str:
    """The name of alpha * value, a tensor or a number."""
    if not isinstance(value, Tensor):
        return t.graph.weight("scalar", np.asarray([value * alpha], np.float32))
    name = t.name(value)
    return name if alpha == 1 else t.graph.add("Mul", [name, operand(t, alpha)], tuple(value.shape))


unary("Relu", "relu", "relu_")
unary("Sigmoid", "sigmoid", "sigmoid_")
unary("Tanh", "tanh")
unary("Exp", "exp")
unary("Reciprocal", "reciprocal")
binary("Add", "add", "add_")
binary("Sub", "sub")
binary("Mul", "mul", "mul_")
binary("Div", "div")
binary("Max", "maximum")
binary("Min", "minimum")


@emits("rsub")
def reversed_difference(t: Tracer, shape: Shape, a: Tensor, b: Any, alpha: float = 1) -> str:
    return t.graph.add("Sub", [operand(t, b), operand(t, a, alpha)], shape)


@emits("clamp")
def clamp(t: Tracer, shape: Shape, x: Tensor, low: float | None = None, high: float | None = None) -> str:
    limits = [-np.inf if low is None else low, np.inf if high is None else high]
    names = [t.graph.weight("limit", np.asarray([value], np.float32)) for value in limits]
    return t.graph.add("Clip", [t.name(x), *names], shape)


@emits("cat")
def concatenate(t: Tracer, shape: Shape, tensors: list[Tensor], axis: int = 0) -> str:
    return t.graph.add("Concat", [t.name(x) for x in tensors], shape, axis=axis % len(shape))


@emits("slice")
def cut(
    t: Tracer,
    shape: Shape,
    x: Tensor,
    axis: int = 0,
    start: int | None = None,
    end: int | None = None,
    step: int = 1,
) -> str:
    if shape == tuple(x.shape):
        return t.name(x)
    size = x.shape[axis]
    end = size if end is None else min(end, size)
    if axis >= 2 and 2 * end > size:  # counted from the end, which lies elsewhere in another size
        end = end - size or LAST
    return t.graph.slice(t.name(x), shape, axis, start or 0, end, step)


@emits("constant_pad_nd")
def pad(t: Tracer, shape: Shape, x: Tensor, pads: list[int], value: float = 0.0) -> str:
    """torch lists (before, after) from the last axis on; ONNX all befores, then all afters, from the first."""
    pairs = list(zip(pads[::2], pads[1::2], strict=True))[::-1]
    pairs = [(0, 0)] * (len(shape) - len(pairs)) + pairs
    amounts = t.graph.integers(*(before for before, _ in pairs), *(after for _, after in pairs))
    fill = t.graph.weight("fill", np.asarray([value], np.float32))
    return t.graph.add("Pad", [t.name(x), amounts, fill], shape, mode="constant")


@emits("pixel_shuffle")
def pixel_shuffle(t: Tracer, shape: Shape, x: Tensor, factor: int) -> str:
    return t.graph.add("DepthToSpace", [t.name(x)], shape, blocksize=factor, mode="CRD")


@emits("upsample_nearest2d")
def nearest(t: Tracer, shape: Shape, x: Tensor, size: list[int], *_: Any) -> str:
    """By whole factors, which ONNX Runtime does in its blocked layout."""
    factors = [n / m for n, m in zip(shape, x.shape, strict=True)]
    if any(factor % 1 for factor in factors):
        raise SettingError(f"export/graph/emitters.py knows nearest neighbours by whole factors only, not {factors}")
    return t.graph.add(
        "Resize",
        [t.name(x), "", t.graph.weight("factors", np.asarray(factors, np.float32))],
        shape,
        mode="nearest",
        coordinate_transformation_mode="asymmetric",
        nearest_mode="floor",
    )


@emits("view", "_unsafe_view", "reshape", "unsqueeze", "squeeze")
def reshape(t: Tracer, shape: Shape, x: Tensor, *_: Any) -> str:
    return t.graph.reshape(t.name(x), shape)


@emits("permute")
def permute(t: Tracer, shape: Shape, x: Tensor, order: list[int]) -> str:
    return t.graph.add("Transpose", [t.name(x)], shape, perm=list(order))


@emits("mean")
def mean(t: Tracer, shape: Shape, x: Tensor, axes: list[int], keepdim: bool = False) -> str:
    return t.graph.add("ReduceMean", [t.name(x)], shape, axes=list(axes), keepdims=int(keepdim))


@emits("_softmax")
def softmax(t: Tracer, shape: Shape, x: Tensor, axis: int, half_to_float: bool) -> str:
    """Over the channels of an image in single steps: ONNX Runtime's Softmax would transpose it there and back.

    Largest and sum of all channels from slices: ReduceMax and ReduceSum take twice as long.
    """
    if axis != 1 or shape[2:] == (1, 1):
        return t.graph.add("Softmax", [t.name(x)], shape, axis=axis)
    one = (shape[0], 1, *shape[2:])

    def channels(name: str) -> list[str]:
        ends = [[t.graph.integers(end) for end in (i, i + 1, 1, 1)] for i in range(shape[1])]
        return [t.graph.add("Slice", [name, *end], one) for end in ends]

    exponent = t.graph.add("Sub", [t.name(x), t.graph.add("Max", channels(t.name(x)), one)], shape)
    exponential = t.graph.add("Exp", [exponent], shape)
    return t.graph.add("Div", [exponential, t.graph.add("Sum", channels(exponential), one)], shape)


@emits("avg_pool2d")
def average_pool(
    t: Tracer,
    shape: Shape,
    x: Tensor,
    kernel: list[int],
    stride: list[int],
    padding: Sequence[int] = (0, 0),
    ceil_mode: bool = False,
    count_include_pad: bool = True,
    divisor: int | None = None,
) -> str:
    if ceil_mode or divisor is not None:
        raise SettingError("export/graph/emitters.py knows average pooling only without ceil_mode and divisor")
    return t.graph.add(
        "AveragePool",
        [t.name(x)],
        shape,
        kernel_shape=list(kernel),
        strides=list(stride),
        pads=[*padding, *padding],
        count_include_pad=int(count_include_pad),
    )

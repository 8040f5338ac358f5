"""Rewriting of the graph: BatchNorms go into convolutions wherever that is exact, kernels lose borders of zeros."""

import numpy as np

from export.graph.convolutions import bias_of, bias_with, is_unpadded, scale_kernel
from export.graph.graph import Graph, Node


def fold_norms(graph: Graph) -> None:
    """Fold each scale and shift into the convolution before it, or else into the one after it.

    After: only a convolution without padding, directly or through a concatenation (in the published networks a
    LeakyReLU stands before the BatchNorm); a padded one sees zeros beyond the border, which have no shift.
    """
    for node in graph.nodes:
        if node.op == "BatchNormalization" and node.output not in graph.outputs:
            _fold_before(graph, node) or _fold_after(graph, node)
    graph.sweep()


def trim_kernels(graph: Graph) -> None:
    """Cut rows and columns of zeros off the borders of kernels, where what the convolution pads can follow."""
    for node in graph.nodes:
        if node.op == "Conv" and node.attributes["dilations"] == [1, 1]:
            weight = graph.weights[node.inputs[1]]
            kernel, pads = weight.values, list(node.attributes["pads"])
            for axis in (0, 1):
                kernel, pads[axis], pads[axis + 2] = _trimmed(graph, node, kernel, axis)
            if kernel.shape != weight.values.shape:
                trimmed = graph.weight(node.inputs[1], kernel, weight.scale)
                graph.rewire(node, [node.inputs[0], trimmed, *node.inputs[2:]])
                node.attributes = node.attributes | {"kernel_shape": list(kernel.shape[2:]), "pads": pads}
    graph.sweep()


def _trimmed(graph: Graph, node: Node, kernel: np.ndarray, axis: int) -> tuple[np.ndarray, int, int]:
    """The kernel without rows (axis 0) or columns (axis 1) of zeros at its ends, and the padding before and after."""
    before, after = node.attributes["pads"][axis], node.attributes["pads"][axis + 2]
    used = np.flatnonzero(np.moveaxis(kernel, axis + 2, 0).reshape(kernel.shape[axis + 2], -1).any(1))
    if not len(used):
        return kernel, before, after
    first, stride = min(int(used[0]), before), node.attributes["strides"][axis]
    pixels, results = (graph.sizes(name)[axis + 2] for name in (node.inputs[0], node.output))
    for end in range(int(used[-1]) + 1, kernel.shape[axis + 2] + 1):  # the first end that leaves the size of the result
        left = max(0, after - (kernel.shape[axis + 2] - end))
        if (pixels + before + left - end) // stride + 1 == results:
            return kernel.take(range(first, end), axis=axis + 2), before - first, left
    raise AssertionError("the whole kernel gives the result's size")


def _fold_before(graph: Graph, norm: Node) -> bool:
    conv = graph.producer(norm.inputs[0])
    if conv is None or conv.op != "Conv" or len(graph.consumers(conv.output)) > 1:
        return False
    scale, shift = scale_and_shift(graph, norm)
    scale_kernel(graph, conv, scale[:, None, None, None], bias_of(graph, conv) * scale + shift)
    graph.replace(norm.output, conv.output)
    return True


def _fold_after(graph: Graph, norm: Node) -> bool:
    first, conv = 0, graph.only_consumer(norm.output)
    if conv is not None and conv.op == "Concat" and conv.inputs.count(norm.output) == 1:
        first = sum(graph.channels(name) for name in conv.inputs[: conv.inputs.index(norm.output)])
        conv = graph.only_consumer(conv.output)
    if conv is None or not is_unpadded(conv):
        return False
    scale, shift = scale_and_shift(graph, norm)
    bias = bias_with(graph, conv, shift, first)
    factors = np.ones((1, graph.channels(conv.inputs[0]), 1, 1))
    factors[0, first : first + len(scale), 0, 0] = scale
    scale_kernel(graph, conv, factors, bias)
    graph.replace(norm.output, norm.inputs[0])
    return True


def scale_and_shift(graph: Graph, norm: Node) -> tuple[np.ndarray, np.ndarray]:
    """(C,) f64 what a BatchNorm multiplies every channel by, and what it adds then."""
    scale, shift = (graph.weights[name].values.astype(np.float64) for name in norm.inputs[1:3])
    return scale, shift

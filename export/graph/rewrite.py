"""Rewriting of the graph: BatchNorms go into convolutions wherever that is exact, kernels lose borders of zeros."""

import numpy as np

from export.graph.graph import Graph, Node


def fold_norms(graph: Graph) -> None:
    """Fold each scale and shift into the convolution before it, or else into the one after it.

    After: only a convolution without padding, directly or through a concatenation (in the published networks a
    LeakyReLU stands before the BatchNorm); a padded one sees zeros beyond the border, which have no shift.
    """
    for node in list(graph.nodes):
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
                node.inputs = [node.inputs[0], trimmed, *node.inputs[2:]]
                node.attributes = node.attributes | {"kernel_shape": list(kernel.shape[2:]), "pads": pads}
    graph.sweep()


def _trimmed(graph: Graph, node: Node, kernel: np.ndarray, axis: int) -> tuple[np.ndarray, int, int]:
    """The kernel without rows (axis 0) or columns (axis 1) of zeros at its ends, and the padding before and after."""
    before, after = node.attributes["pads"][axis], node.attributes["pads"][axis + 2]
    used = np.flatnonzero(np.moveaxis(kernel, axis + 2, 0).reshape(kernel.shape[axis + 2], -1).any(1))
    if not len(used):
        return kernel, before, after
    first, stride = min(int(used[0]), before), node.attributes["strides"][axis]
    pixels, results = (int(graph.shapes[name][axis + 2]) for name in (node.inputs[0], node.output))
    for end in range(int(used[-1]) + 1, kernel.shape[axis + 2] + 1):  # the first end that leaves the size of the result
        left = max(0, after - (kernel.shape[axis + 2] - end))
        if (pixels + before + left - end) // stride + 1 == results:
            return kernel.take(range(first, end), axis=axis + 2), before - first, left
    raise AssertionError("the whole kernel gives the result's size")


def _fold_before(graph: Graph, norm: Node) -> bool:
    conv = graph.producer(norm.inputs[0])
    if conv is None or conv.op != "Conv" or len(graph.consumers(conv.output)) > 1:
        return False
    scale, shift = _affine(graph, norm)
    bias = bias_of(graph, conv) * scale + shift
    scale_kernel(graph, conv, scale[:, None, None, None], bias)
    graph.replace(norm.output, conv.output)
    return True


def _fold_after(graph: Graph, norm: Node) -> bool:
    first, conv = 0, only_consumer(graph, norm.output)
    if conv is not None and conv.op == "Concat" and conv.inputs.count(norm.output) == 1:
        before = conv.inputs[: conv.inputs.index(norm.output)]
        first, conv = sum(graph.shapes[name][1] for name in before), only_consumer(graph, conv.output)
    if conv is None or not is_unpadded(conv):
        return False
    scale, shift = _affine(graph, norm)
    weight = graph.weights[conv.inputs[1]].folded()
    channels = slice(first, first + len(scale))
    bias = bias_of(graph, conv) + np.einsum("oihw,i->o", weight[:, channels].astype(np.float64), shift)
    factors = np.ones((1, weight.shape[1], 1, 1))
    factors[0, channels, 0, 0] = scale
    scale_kernel(graph, conv, factors, bias)
    graph.replace(norm.output, norm.inputs[0])
    return True


def is_plain(node: Node) -> bool:
    """Whether a node is a convolution of all channels with all."""
    return node.op == "Conv" and node.attributes["group"] == 1


def is_unpadded(node: Node) -> bool:
    """Whether it is such a convolution and sees nothing beyond the border."""
    return is_plain(node) and not any(node.attributes["pads"])


def only_consumer(graph: Graph, name: str) -> Node | None:
    """The one node that takes `name`; None where there are others, or `name` is an output."""
    consumers = graph.consumers(name)
    return consumers[0] if len(consumers) == 1 and name not in graph.outputs else None


def _affine(graph: Graph, norm: Node) -> tuple[np.ndarray, np.ndarray]:
    scale, shift = (graph.weights[name].values.astype(np.float64) for name in norm.inputs[1:3])
    return scale, shift


def bias_of(graph: Graph, conv: Node) -> np.ndarray:
    """(C,) f64 bias of a convolution, zeros where it has none."""
    if len(conv.inputs) > 2:
        return graph.weights[conv.inputs[2]].values.astype(np.float64)
    return np.zeros(graph.shapes[conv.output][1])


def scale_kernel(graph: Graph, conv: Node, factors: np.ndarray, bias: np.ndarray) -> None:
    """Multiply the kernel by `factors` and give the convolution a new bias."""
    weight = graph.weights[conv.inputs[1]]
    scale = factors if weight.scale is None else weight.scale * factors
    conv.inputs[1] = graph.weight(conv.inputs[1], weight.values, scale)
    set_bias(graph, conv, bias)


def set_convolution(graph: Graph, conv: Node, kernel: np.ndarray, bias: np.ndarray) -> None:
    """Give a convolution another kernel and bias."""
    conv.inputs[1] = graph.weight(f"{conv.output}.kernel", np.float32(kernel))
    set_bias(graph, conv, bias)


def set_bias(graph: Graph, conv: Node, bias: np.ndarray) -> None:
    """Give a convolution another bias."""
    conv.inputs[2:] = [graph.weight(f"{conv.output}.bias", np.float32(bias))]

"""Kernel and bias of a convolution: read and changed."""

import numpy as np

from export.graph.graph import Graph, Node


def is_plain(node: Node) -> bool:
    """Whether a node is a convolution of all channels with all."""
    return node.op == "Conv" and node.attributes["group"] == 1


def is_unpadded(node: Node) -> bool:
    """Whether it is such a convolution and sees nothing beyond the border."""
    return is_plain(node) and not any(node.attributes["pads"])


def kernel_of(graph: Graph, conv: Node) -> np.ndarray:
    """(O, I / group, kh, kw) f32 kernel of a convolution."""
    return graph.weights[conv.inputs[1]].folded()


def bias_of(graph: Graph, conv: Node) -> np.ndarray:
    """(O,) f64 bias of a convolution, zeros where it has none."""
    if len(conv.inputs) > 2:
        return np.asarray(graph.weights[conv.inputs[2]].values, np.float64)
    return np.zeros(graph.channels(conv.output))


def bias_with(graph: Graph, conv: Node, shift: np.ndarray, first: int = 0) -> np.ndarray:
    """(O,) f64 bias of a convolution to whose input channels, from `first` on, `shift` is added."""
    kernel = kernel_of(graph, conv)[:, first : first + len(shift)]
    bias: np.ndarray = bias_of(graph, conv) + np.einsum("oihw,i->o", kernel.astype(np.float64), shift)
    return bias


def scale_kernel(graph: Graph, conv: Node, factors: np.ndarray, bias: np.ndarray) -> None:
    """Multiply the kernel by `factors` and give the convolution a new bias."""
    weight = graph.weights[conv.inputs[1]]
    scale = factors if weight.scale is None else weight.scale * factors
    kernel = graph.weight(conv.inputs[1], weight.values, scale)
    graph.rewire(conv, [conv.inputs[0], kernel])
    set_bias(graph, conv, bias)


def set_convolution(graph: Graph, conv: Node, kernel: np.ndarray, bias: np.ndarray) -> None:
    """Give a convolution another kernel and bias."""
    graph.rewire(conv, [conv.inputs[0], graph.weight(f"{conv.output}.kernel", kernel)])
    set_bias(graph, conv, bias)


def set_bias(graph: Graph, conv: Node, bias: np.ndarray) -> None:
    """Give a convolution another bias."""
    graph.rewire(conv, [*conv.inputs[:2], graph.weight(f"{conv.output}.bias", bias)])

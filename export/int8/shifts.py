"""Rewriting for the integer graph: BatchNorm after the activation leaves the convolution's output.

A block of the paper computes s * leaky(conv(x)) + b. A positive s goes into the convolution, for leaky(s x) =
s leaky(x). What remains of the BatchNorm is a shift of every channel, which this module carries forward to where it
costs nothing. The activation becomes a ReLU, which an integer convolution does by itself: see `to_relu`.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from export.graph.graph import Graph, Node
from export.graph.rewrite import bias_of, is_unpadded, only_consumer, scale_kernel, set_bias


class Halves(NamedTuple):
    """What a LeakyRelu takes, by channel (C,): means and variances of max(x, 0) and of max(-x, 0)."""

    above: np.ndarray
    above_variance: np.ndarray
    below: np.ndarray
    below_variance: np.ndarray
    lowest: np.ndarray  # largest of max(-x, 0)


def leaky_convolutions(graph: Graph) -> list[Node]:
    """The LeakyRelu nodes that stand directly behind a convolution which nothing else reads."""
    found = []
    for node in graph.nodes:
        conv = graph.producer(node.inputs[0]) if node.op == "LeakyRelu" else None
        if conv is not None and conv.op == "Conv" and len(graph.consumers(conv.output)) == 1:
            found.append(node)
    return found


def to_relu(graph: Graph, halves: Mapping[str, Halves]) -> None:
    """Turn conv -> LeakyRelu -> BatchNorm into conv -> Relu -> shift.

    halves: of each LeakyRelu, by the name of its output. Of a channel one half is kept, and of the other one the mean,
    which joins the shift: mostly that above zero, for below LeakyRelu lets a hundredth through. But a channel that is
    hardly ever above zero lives from that hundredth, since the BatchNorm has made it large again: there the straight
    line below zero is kept, and raised so far that the Relu does not meet it.
    """
    for node in leaky_convolutions(graph):
        conv = graph.producer(node.inputs[0])
        assert conv is not None
        followers = graph.consumers(node.output)
        norm = followers[0] if len(followers) == 1 and followers[0].op == "BatchNormalization" else None
        scale, shift = np.ones(graph.shapes[conv.output][1]), np.zeros(graph.shapes[conv.output][1])
        if norm is not None:
            scale, shift = (graph.weights[name].values.astype(np.float64) for name in norm.inputs[1:3])
        slope, half = node.attributes["alpha"], halves[node.output]
        straight = (1 - slope) ** 2 * half.above_variance < slope**2 * half.below_variance
        size = np.abs(scale) * np.where(straight, slope, 1)
        raised = np.where(straight, size * half.lowest, 0)
        scale_kernel(graph, conv, size[:, None, None, None], bias_of(graph, conv) * size + raised)
        last = norm or node
        result = graph.new_name("relu", graph.shapes[last.output])
        tail = [Node("Relu", [conv.output], result)]
        if (scale < 0).any():
            signed = graph.new_name("sign", graph.shapes[last.output])
            tail.append(Node("Mul", [result, shift_constant(graph, np.sign(scale))], signed))
            result = signed
        dropped = np.where(straight, (1 - slope) * half.above, -slope * half.below)
        shift = shift + scale * dropped - np.sign(scale) * raised
        tail.append(Node("Add", [result, shift_constant(graph, shift)], last.output))
        at = graph.nodes.index(node)
        graph.nodes[at : at + 1] = tail
        if norm is not None:
            graph.nodes.remove(norm)
    graph.sweep()


def carry_shifts(graph: Graph) -> None:
    """Move every shift forward: through sums, concatenations and pools, into the bias of convolutions.

    In front of a convolution that pads with zeros it stays: beyond the border there is no shift.
    """
    moved = True
    while moved:
        moved = any(_carry(graph, node) for node in list(graph.nodes) if shift_of(graph, node) is not None)
        graph.sweep()


def shift_of(graph: Graph, node: Node) -> np.ndarray | None:
    """The constant (C,) that a node adds to every channel; None if it does not."""
    if node.op != "Add" or node.inputs[1] not in graph.weights:
        return None
    values = graph.weights[node.inputs[1]].values
    return values.reshape(-1).astype(np.float64) if values.ndim == 4 and values.shape[2:] == (1, 1) else None


def _carry(graph: Graph, node: Node) -> bool:
    shift = shift_of(graph, node)
    assert shift is not None
    before, after = node.inputs[0], node.output
    consumers = graph.consumers(after)
    if not shift.any():
        if after in graph.outputs:
            return False
        graph.replace(after, before)
        return True
    free = [consumer for consumer in consumers if _absorbs(graph, consumer)]
    if after not in graph.outputs and all(_carriable(graph, c) for c in consumers):
        free = consumers
    for consumer in free:
        _pass(graph, consumer, before, after, shift)
    return bool(free)


def _absorbs(graph: Graph, node: Node) -> bool:
    """Whether the shift disappears in a bias, behind a concatenation perhaps."""
    after = only_consumer(graph, node.output) if node.op == "Concat" else node
    return after is not None and is_unpadded(after)


def _carriable(graph: Graph, node: Node) -> bool:
    """Whether a shift of every channel can stand behind `node` (or in its bias) instead of before it."""
    if is_unpadded(node):
        return True
    if node.op == "Mul":
        return node.inputs[1] in graph.weights
    if node.op == "AveragePool":
        return not any(node.attributes["pads"])
    return node.op in ("Add", "Concat", "SoftPool") and node.output not in graph.outputs


def _pass(graph: Graph, node: Node, before: str, after: str, shift: np.ndarray) -> None:
    """Let `node` take `before` for `after` (= before + shift), and put right what it computes."""
    if node.op == "Conv":
        kernel = graph.weights[node.inputs[1]].folded()
        bias = bias_of(graph, node) + np.einsum("oihw,i->o", kernel.astype(np.float64), shift)
        node.inputs[0] = before
        set_bias(graph, node, bias)
        return
    if (own := shift_of(graph, node)) is not None:
        node.inputs = [before, shift_constant(graph, own + shift)]
        return
    if node.op == "Concat":
        parts = [shift if name == after else np.zeros(graph.shapes[name][1]) for name in node.inputs]
        shift = np.concatenate(parts)
    elif node.op == "Mul":
        shift = shift * graph.weights[node.inputs[1]].values.reshape(-1)
    elif node.op == "Add":
        shift = shift * node.inputs.count(after)
    node.inputs = [before if name == after else name for name in node.inputs]
    result, node.output = node.output, graph.new_name(node.op, graph.shapes[node.output])
    graph.nodes.insert(graph.nodes.index(node) + 1, Node("Add", [node.output, shift_constant(graph, shift)], result))


def shift_constant(graph: Graph, values: np.ndarray) -> str:
    """Store a number for every channel (C,) as what a node adds or multiplies; its name."""
    return graph.weight("shift", np.float32(values)[None, :, None, None])

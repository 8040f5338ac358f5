"""Rewriting for the integer graph: BatchNorm after the activation leaves the convolution's output.

A block of the paper computes s * leaky(conv(x)) + b. A positive s goes into the convolution, for leaky(s x) =
s leaky(x). What remains of the BatchNorm is a shift of every channel, which this module carries forward to where it
costs nothing. The activation becomes a ReLU, which an integer convolution does by itself: see `to_relu`.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from export.graph.convolutions import bias_of, bias_with, is_unpadded, scale_kernel, set_bias
from export.graph.graph import Graph, Node
from export.graph.operations import traits
from export.graph.rewrite import scale_and_shift


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
        scale, shift = np.ones(graph.channels(conv.output)), np.zeros(graph.channels(conv.output))
        if norm is not None:
            scale, shift = scale_and_shift(graph, norm)
        slope, half = node.attributes["alpha"], halves[node.output]
        straight = (1 - slope) ** 2 * half.above_variance < slope**2 * half.below_variance
        size = np.abs(scale) * np.where(straight, slope, 1)
        raised = np.where(straight, size * half.lowest, 0)
        scale_kernel(graph, conv, size[:, None, None, None], bias_of(graph, conv) * size + raised)
        dropped = np.where(straight, (1 - slope) * half.above, -slope * half.below)
        shift = shift + scale * dropped - np.sign(scale) * raised
        shape = graph.shapes[conv.output]
        with graph.before(node):
            result = graph.add("Relu", [conv.output], shape)
            if (scale < 0).any():
                result = graph.add("Mul", [result, channel_constant(graph, np.sign(scale))], shape)
            result = graph.add("Add", [result, channel_constant(graph, shift)], shape)
        graph.supplant(norm or node, result)
    graph.sweep()


def carry_shifts(graph: Graph) -> None:
    """Move every shift forward: through sums, concatenations and pools, into the bias of convolutions.

    In front of a convolution that pads with zeros it stays: beyond the border there is no shift.
    """
    while any(_carry(graph, node) for node in graph.nodes):
        graph.sweep()


def shift_of(graph: Graph, node: Node) -> np.ndarray | None:
    """The constant (C,) that a node adds to every channel; None if it does not."""
    if node.op != "Add" or node.inputs[1] not in graph.weights:
        return None
    values = graph.weights[node.inputs[1]].values
    return values.reshape(-1).astype(np.float64) if values.ndim == 4 and values.shape[2:] == (1, 1) else None


def channel_constant(graph: Graph, values: np.ndarray) -> str:
    """Store a number for every channel (C,) as what a node adds or multiplies; its name."""
    return graph.weight("shift", values[None, :, None, None])


def _carry(graph: Graph, node: Node) -> bool:
    """Move what a node adds behind those that take its sum, as far as that is possible; whether it was."""
    shift = shift_of(graph, node)
    if shift is None:
        return False
    before, after = node.inputs[0], node.output
    if not shift.any():
        if after in graph.outputs:
            return False
        graph.replace(after, before)
        return True
    consumers = graph.consumers(after)
    free = [consumer for consumer in consumers if _absorbs(graph, consumer)]
    if after not in graph.outputs and all(_passes(graph, consumer) for consumer in consumers):
        free = list(consumers)
    for consumer in free:
        _move_behind(graph, consumer, before, after, shift)
    return bool(free)


def _absorbs(graph: Graph, node: Node) -> bool:
    """Whether the shift disappears in a bias, behind a concatenation perhaps."""
    after = graph.only_consumer(node.output) if node.op == "Concat" else node
    return after is not None and is_unpadded(after)


def _passes(graph: Graph, node: Node) -> bool:
    """Whether a shift of every channel can stand behind `node` (or in its bias) instead of before it."""
    if is_unpadded(node):
        return True
    if node.op == "Mul":
        return node.inputs[1] in graph.weights
    return traits(node).passes_shift and not any(node.attributes.get("pads", ())) and node.output not in graph.outputs


def _move_behind(graph: Graph, node: Node, before: str, after: str, shift: np.ndarray) -> None:
    """Let `node` take `before` for `after` (= before + shift), and put right what it computes."""
    inputs = [before if name == after else name for name in node.inputs]
    if node.op == "Conv":
        bias = bias_with(graph, node, shift)
        graph.rewire(node, inputs)
        set_bias(graph, node, bias)
        return
    if (own := shift_of(graph, node)) is not None:
        graph.rewire(node, [before, channel_constant(graph, own + shift)])
        return
    if node.op == "Concat":
        shift = np.concatenate([shift if n == after else np.zeros(graph.channels(n)) for n in node.inputs])
    elif node.op == "Mul":
        shift = shift * graph.weights[node.inputs[1]].values.reshape(-1)
    elif node.op == "Add":
        shift = shift * node.inputs.count(after)
    shape = graph.shapes[node.output]
    with graph.before(node):
        result = graph.add(node.op, inputs, shape, **node.attributes)
        result = graph.add("Add", [result, channel_constant(graph, shift)], shape)
    graph.supplant(node, result)

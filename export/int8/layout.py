"""Rewriting for the integer graph, whose maps have the channels last: pixel shuffles, gates, factors."""

import numpy as np

from export.graph.graph import Graph, Node
from export.graph.rewrite import bias_of, is_plain, set_convolution

PASSING = ("Relu", "LeakyRelu")


def means_to_pools(graph: Graph) -> None:
    """Let means over whole maps be pools, which there are for integers."""
    for node in graph.nodes:
        if node.op == "ReduceMean" and node.attributes.get("axes") == [2, 3] and node.attributes.get("keepdims"):
            node.op, node.attributes = "GlobalAveragePool", {}


def spread_factors(graph: Graph) -> None:
    """Repeat a factor (1, C, 1, 1) over a row before it meets a map: met pixel by pixel it takes four times as long."""
    for node in list(graph.nodes):
        if node.op != "Mul" or len(graph.shapes[node.output]) != 4 or node.inputs[1] in graph.weights:
            continue
        channels, width = graph.shapes[node.output][1], graph.shapes[node.output][3]
        if graph.shapes[node.inputs[1]] == (1, channels, 1, 1) and width != 1:
            shape = (1, channels, 1, width)
            row = graph.new_name("expand", shape)
            size = graph.weight("integers", np.asarray(shape, np.int64))
            graph.nodes.insert(graph.nodes.index(node), Node("Expand", [node.inputs[1], size], row))
            node.inputs = [node.inputs[0], row]


def spread_gates(graph: Graph) -> None:
    """Let a convolution that gates a map pixel by pixel have the map's channels, all alike.

    Met by its (1, C, H, W) a gate (1, 1, H, W) takes ten times as long as one of the same shape.
    """
    for node in list(graph.nodes):
        if node.op != "Mul" or len(graph.shapes[node.output]) != 4:
            continue
        channels = graph.shapes[node.output][1]
        for name in node.inputs:
            way = _way_to_gate(graph, name)
            if way and channels != 1:
                conv, count = way[-1], int(channels)
                kernel = graph.weights[conv.inputs[1]].folded()
                set_convolution(graph, conv, kernel.repeat(count, axis=0), bias_of(graph, conv).repeat(count))
                for step in way:
                    graph.shapes[step.output] = (1, channels, *graph.shapes[step.output][2:])


def _way_to_gate(graph: Graph, name: str) -> list[Node]:
    """The nodes from a map of one channel back to the convolution that made it, if nothing else reads them."""
    way: list[Node] = []
    while (node := graph.producer(name)) is not None and len(graph.consumers(name)) == 1 and name not in graph.outputs:
        if graph.shapes[name][1:2] != (1,) or graph.shapes[name][2:] == (1, 1):
            return []
        way.append(node)
        if node.op == "Conv":
            return way
        if node.op != "Sigmoid":
            return []
        name = node.inputs[0]
    return []


def shuffle_blocks(graph: Graph) -> None:
    """Let pixel shuffles move runs of channels instead of single ones.

    The channels that become one pixel lie c apart in torch's order; the convolutions before are put in the order in
    which they lie together. Shuffles that other nodes look into stay as they are.
    """
    for node in list(graph.nodes):
        if node.op != "DepthToSpace" or node.attributes["mode"] != "CRD":
            continue
        channels = graph.shapes[node.inputs[0]][1]
        size = node.attributes["blocksize"]
        c = channels // size**2
        order = np.arange(channels).reshape(c, size * size).T.reshape(-1)
        way = _way_back(graph, node.inputs[0]) if len(graph.consumers(node.inputs[0])) == 1 else None
        if way is None:
            continue
        for maker in _with_weights(graph, way):
            _reorder(graph, maker, order)
        node.attributes = node.attributes | {"mode": "DCR"}
    graph.sweep()


def _way_back(graph: Graph, name: str) -> list[Node] | None:
    """The nodes from the convolutions that made `name` on; None where something else takes a value on the way."""
    node = graph.producer(name)
    if node is None or name in graph.outputs:
        return None
    if is_plain(node):
        return [node]
    constant = node.op == "Add" and node.inputs[1] in graph.weights
    if not constant and node.op not in (*PASSING, "Add"):
        return None
    parts = node.inputs[:2] if node.op == "Add" and not constant else node.inputs[:1]
    way: list[Node] = []
    for part in parts:
        before = _way_back(graph, part) if len(graph.consumers(part)) == 1 else None
        if before is None:
            return None
        way += before
    return [*way, node]


def _with_weights(graph: Graph, nodes: list[Node]) -> list[Node]:
    """Those with weights for every channel: convolutions, and sums with a constant."""
    return [n for n in nodes if n.op == "Conv" or (n.op == "Add" and n.inputs[1] in graph.weights)]


def _reorder(graph: Graph, node: Node, order: np.ndarray) -> None:
    names = node.inputs[1:]
    axis = 0 if node.op == "Conv" else 1
    node.inputs = [node.inputs[0]]
    for name in names:
        values = graph.weights[name].folded().take(order, axis=axis)
        node.inputs.append(graph.weight(name, values))

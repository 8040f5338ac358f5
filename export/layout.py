"""Rewriting for the integer graph, whose maps have the channels last: pixel shuffles, joins, gates, factors."""

import numpy as np

from export.graph import Graph, Node
from export.rewrite import bias_of
from export.shifts import set_convolution

PASSING = ("Relu", "LeakyRelu")
SHUFFLING = ("DepthToSpace", "Resize")
LARGEST_FACTOR = 256.0  # by which a part of a concatenation is multiplied or divided


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
        way = _way_back(graph, node.inputs[0], PASSING) if len(graph.consumers(node.inputs[0])) == 1 else None
        if way is None:
            continue
        for maker in _with_weights(graph, way):
            _reorder(graph, maker, order)
        node.attributes = node.attributes | {"mode": "DCR"}
    graph.sweep()


def balance_joins(graph: Graph, ranges: dict[str, tuple[float, float]]) -> None:
    """Let parts of a concatenation have ranges of one width, so that they can share their scale.

    A part is multiplied where it is made, by what the kernels of the convolutions that take it are divided by; `ranges`
    are changed with it. Parts that something else takes too stay as they are: the others follow them.
    """
    for join in [node for node in graph.nodes if node.op == "Concat" and ranges.keys() >= set(node.inputs)]:
        after = graph.consumers(join.output)
        if len(after) != 1 or not _is_plain(after[0]):
            continue
        widths = [ranges[name][1] - ranges[name][0] for name in join.inputs]
        others = [[node for node in graph.consumers(name) if node is not join] for name in join.inputs]
        ways = [
            _way_back(graph, name, (*PASSING, *SHUFFLING)) if all(map(_is_plain, takers)) else None
            for name, takers in zip(join.inputs, others, strict=True)
        ]
        fixed = [width for width, way in zip(widths, ways, strict=True) if way is None]
        first = 0
        for name, width, way, takers in zip(join.inputs, widths, ways, others, strict=True):
            channels = slice(first, first + int(graph.shapes[name][1]))
            first = channels.stop
            factor = max(fixed or widths) / max(width, 1e-6)
            if way is None or not 1 / LARGEST_FACTOR <= factor <= LARGEST_FACTOR:
                continue
            for maker in _with_weights(graph, way):
                _multiply(graph, maker, factor)
            for output in {node.output for node in way} & set(ranges):
                ranges[output] = (ranges[output][0] * factor, ranges[output][1] * factor)
            for node, part in ((after[0], channels), *((taker, slice(None)) for taker in takers)):
                kernel = graph.weights[node.inputs[1]].folded().astype(np.float64)
                kernel[:, part] /= factor
                set_convolution(graph, node, kernel, bias_of(graph, node))
    graph.sweep()


def _is_plain(node: Node) -> bool:
    return node.op == "Conv" and node.attributes["group"] == 1


def _way_back(graph: Graph, name: str, through: tuple[str, ...]) -> list[Node] | None:
    """The nodes between `name` and the convolutions that made it; None where something else takes a value on the way.

    through: operations of one map that may lie on it, beside sums.
    """
    node = graph.producer(name)
    if node is None or name in graph.outputs:
        return None
    if _is_plain(node):
        return [node]
    constant = node.op == "Add" and node.inputs[1] in graph.weights
    if not constant and node.op not in (*through, "Add"):
        return None
    parts = node.inputs[:2] if node.op == "Add" and not constant else node.inputs[:1]
    way = []
    for part in parts:
        before = _way_back(graph, part, through) if len(graph.consumers(part)) == 1 else None
        if before is None:
            return None
        way += before
    return [*way, node]


def _with_weights(graph: Graph, nodes: list[Node]) -> list[Node]:
    """Those with weights for every channel: convolutions, and sums with a constant."""
    return [n for n in nodes if n.op == "Conv" or (n.op == "Add" and n.inputs[1] in graph.weights)]


def _multiply(graph: Graph, node: Node, factor: float) -> None:
    if node.op == "Conv":
        kernel = graph.weights[node.inputs[1]].folded() * factor
        set_convolution(graph, node, kernel, bias_of(graph, node) * factor)
    else:
        values = np.float32(graph.weights[node.inputs[1]].folded() * factor)
        node.inputs = [node.inputs[0], graph.weight("shift", values)]


def _reorder(graph: Graph, node: Node, order: np.ndarray) -> None:
    names = node.inputs[1:]
    axis = 0 if node.op == "Conv" else 1
    node.inputs = [node.inputs[0]]
    for name in names:
        values = graph.weights[name].folded().take(order, axis=axis)
        node.inputs.append(graph.weight(name, values))

"""Rewriting for the integer graph, whose maps have the channels last: pixel shuffles, joins, gates, factors."""

import numpy as np

from export.graph import Graph, Node
from export.rewrite import bias_of, is_plain, only_consumer, scale_kernel, set_convolution

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
        after = only_consumer(graph, join.output)
        if after is None or not is_plain(after):
            continue
        widths = [ranges[name][1] - ranges[name][0] for name in join.inputs]
        ways = [_way_to_makers(graph, name, join) for name in join.inputs]
        target = max([width for width, way in zip(widths, ways, strict=True) if way is None] or widths)
        first, balanced = 0, False
        for name, width, way in zip(join.inputs, widths, ways, strict=True):
            channels = slice(first, first + int(graph.shapes[name][1]))
            first = channels.stop
            factor = target / max(width, 1e-6)
            if way is None or not 1 / LARGEST_FACTOR <= factor <= LARGEST_FACTOR:
                continue
            balanced = True
            _multiply(graph, way, factor, ranges)
            for taker in graph.consumers(name):
                if taker is not join:
                    _divide(graph, taker, slice(None), factor)
            _divide(graph, after, channels, factor)
        if balanced:
            parts = [ranges[name] for name in join.inputs]
            ranges[join.output] = (min(low for low, _ in parts), max(high for _, high in parts))
    graph.sweep()


def _way_to_makers(graph: Graph, name: str, join: Node) -> list[Node] | None:
    """As `_way_back`, for one of the parts of `join` that only convolutions take beside it."""
    others = [node for node in graph.consumers(name) if node is not join]
    if join.inputs.count(name) > 1 or not all(map(is_plain, others)):
        return None
    return _way_back(graph, name, (*PASSING, *SHUFFLING))


def _multiply(graph: Graph, way: list[Node], factor: float, ranges: dict[str, tuple[float, float]]) -> None:
    """Multiply what nodes compute, and their ranges: see `_way_back`."""
    for node in _with_weights(graph, way):
        if node.op == "Conv":
            scale_kernel(graph, node, np.full((1, 1, 1, 1), factor), bias_of(graph, node) * factor)
        else:
            values = np.float32(graph.weights[node.inputs[1]].folded() * factor)
            node.inputs = [node.inputs[0], graph.weight("shift", values)]
    for name in {node.output for node in way} & ranges.keys():
        ranges[name] = (ranges[name][0] * factor, ranges[name][1] * factor)


def _divide(graph: Graph, conv: Node, channels: slice, factor: float) -> None:
    """Divide the kernel of a convolution for some of its inputs."""
    factors = np.ones((1, graph.weights[conv.inputs[1]].values.shape[1], 1, 1))
    factors[:, channels] = 1 / factor
    scale_kernel(graph, conv, factors, bias_of(graph, conv))


def _way_back(graph: Graph, name: str, through: tuple[str, ...]) -> list[Node] | None:
    """The nodes between `name` and the convolutions that made it; None where something else takes a value on the way.

    through: operations of one map that may lie on it, beside sums.
    """
    node = graph.producer(name)
    if node is None or name in graph.outputs:
        return None
    if is_plain(node):
        return [node]
    constant = node.op == "Add" and node.inputs[1] in graph.weights
    if not constant and node.op not in (*through, "Add"):
        return None
    parts = node.inputs[:2] if node.op == "Add" and not constant else node.inputs[:1]
    way: list[Node] = []
    for part in parts:
        before = _way_back(graph, part, through) if len(graph.consumers(part)) == 1 else None
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

"""Rewriting for the integer graph, whose maps have the channels last: pixel shuffles, gates, factors, logits."""

import numpy as np

from export.graph.convolutions import bias_of, is_plain, is_unpadded, kernel_of, set_convolution
from export.graph.graph import Graph, Node
from export.graph.operations import traits
from export.int8.shifts import shift_of


def means_to_pools(graph: Graph) -> None:
    """Let means over whole maps be pools, which there are for integers."""
    for node in graph.nodes:
        if node.op == "ReduceMean" and node.attributes.get("axes") == [2, 3] and node.attributes.get("keepdims"):
            with graph.before(node):
                pool = graph.add("GlobalAveragePool", node.inputs, graph.shapes[node.output])
            graph.supplant(node, pool)


def spread_factors(graph: Graph) -> None:
    """Repeat a factor (1, C, 1, 1) over a row before it meets a map: met pixel by pixel it takes four times as long."""
    for node in _products(graph):
        _, channels, _, width = graph.sizes(node.output)
        if graph.shapes.get(node.inputs[1]) == (1, channels, 1, 1) and width != 1:
            shape = (1, channels, 1, width)
            with graph.before(node):
                row = graph.add("Expand", [node.inputs[1], graph.integers(*shape)], shape)
            graph.rewire(node, [node.inputs[0], row])


def spread_gates(graph: Graph) -> None:
    """Let a convolution that gates a map pixel by pixel have the map's channels, all alike.

    Met by its (1, C, H, W) a gate (1, 1, H, W) takes ten times as long as one of the same shape.
    """
    for node in _products(graph):
        channels = graph.channels(node.output)
        for name in node.inputs:
            way = _way_to_gate(graph, name)
            if way and channels != 1:
                conv = way[-1]
                kernel, bias = kernel_of(graph, conv), bias_of(graph, conv)
                set_convolution(graph, conv, kernel.repeat(channels, axis=0), bias.repeat(channels))
                for step in way:
                    graph.shapes[step.output] = (1, channels, *graph.shapes[step.output][2:])


def to_product(graph: Graph, conv: Node) -> None:
    """Let a convolution in float that sees one pixel be a matrix product: few channels of it fill no block of ONNX's.

    The same bits. Others stay as they are.
    """
    if not is_unpadded(conv) or kernel_of(graph, conv).shape[2:] != (1, 1) or conv.attributes["strides"] != [1, 1]:
        return
    made, channels, pixels = graph.channels(conv.output), graph.channels(conv.inputs[0]), graph.sizes(conv.output)[2:]
    with graph.before(conv):
        kernel = graph.reshape(conv.inputs[1], (made, channels))
        values = graph.reshape(conv.inputs[0], (channels, pixels[0] * pixels[1]))
        product = graph.add("MatMul", [kernel, values], (made, pixels[0] * pixels[1]))
        bias = graph.weight(f"{conv.output}.bias", bias_of(graph, conv)[:, None])
        total = graph.add("Add", [product, bias], graph.shapes[product])
        image = graph.reshape(total, (1, made, *pixels))
    graph.supplant(conv, image)


def _products(graph: Graph) -> list[Node]:
    """The nodes that multiply maps (1, C, H, W)."""
    return [node for node in graph.nodes if node.op == "Mul" and len(graph.shapes[node.output]) == 4]


def _way_to_gate(graph: Graph, name: str) -> list[Node]:
    """The nodes from a map of one channel back to the convolution that made it, if nothing else reads them."""
    way: list[Node] = []
    while (node := graph.producer(name)) is not None and graph.only_consumer(name) is not None:
        if graph.shapes[name][1:2] != (1,) or graph.shapes[name][2:] == (1, 1):
            return []
        way.append(node)
        if node.op == "Conv":
            return way
        if not traits(node).elementwise:
            return []
        name = node.inputs[0]
    return []


def shuffle_blocks(graph: Graph) -> None:
    """Let pixel shuffles move runs of channels instead of single ones.

    The channels that become one pixel lie c apart in torch's order; the convolutions before are put in the order in
    which they lie together. Shuffles that other nodes look into stay as they are.
    """
    for node in graph.nodes:
        if node.op != "DepthToSpace" or node.attributes["mode"] != "CRD":
            continue
        makers = _makers(graph, node.inputs[0])
        if makers is None:
            continue
        channels, size = graph.channels(node.inputs[0]), node.attributes["blocksize"] ** 2
        order = np.arange(channels).reshape(channels // size, size).T.reshape(-1)
        for maker in makers:
            _reorder(graph, maker, order)
        node.attributes = node.attributes | {"mode": "DCR"}
    graph.sweep()


def _makers(graph: Graph, name: str) -> list[Node] | None:
    """The nodes with weights of each channel of `name`, back to convolutions; None where others take what they make."""
    node = graph.producer(name)
    if node is None or graph.only_consumer(name) is None:
        return None
    if is_plain(node):
        return [node]
    weighted = shift_of(graph, node) is not None
    if node.op != "Add" and not traits(node).elementwise:
        return None
    found = [node] if weighted else []
    for part in node.inputs[:1] if weighted or node.op != "Add" else node.inputs:
        makers = _makers(graph, part)
        if makers is None:
            return None
        found += makers
    return found


def _reorder(graph: Graph, node: Node, order: np.ndarray) -> None:
    """Put the weights of the channels that a node makes in another order."""
    axis = 0 if node.op == "Conv" else 1
    orders = ((name, graph.weights[name].folded().take(order, axis=axis)) for name in node.inputs[1:])
    graph.rewire(node, [node.inputs[0], *(graph.weight(name, values) for name, values in orders)])

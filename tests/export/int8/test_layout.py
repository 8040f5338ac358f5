"""What suits channels that lie last, with the same results."""

import numpy as np
import pytest

from export.graph.image_graph import trace
from export.int8.layout import spread_gates
from tests.support.graphs import SHAPE, image, network, run


@pytest.mark.parametrize("name", ["v1", "rt"])
def test_gates_of_whole_maps_give_the_same(name):
    graph = trace(network(name), SHAPE)
    before = run(graph, image())
    spread_gates(graph)
    for kept, spread in zip(before, run(graph, image()), strict=True):
        np.testing.assert_array_equal(spread, kept)
    gates = [n for n in graph.nodes if n.op == "Mul" and any(graph.shapes.get(i, ())[1:2] == (1,) for i in n.inputs)]
    assert not gates
    sizes = [graph.shapes[node.output][1] for node in graph.nodes if node.op == "Conv"]
    assert sizes.count(1) == 0


def test_a_gate_that_others_read_stays_as_it_is():
    graph = trace(network("rt"), SHAPE)
    gate = next(node for node in graph.nodes if node.op == "Conv" and graph.shapes[node.output][1] == 1)
    graph.outputs.append(gate.output)
    before = run(graph, image())
    spread_gates(graph)
    assert graph.shapes[gate.output][1] == 1
    for kept, spread in zip(before, run(graph, image()), strict=True):
        np.testing.assert_array_equal(spread, kept)

"""What suits channels that lie last, with the same results."""

import numpy as np
import pytest

from export.graph.image_graph import trace
from export.int8.before_channels_last import shuffle_blocks, spread_gates, to_product
from tests.support.graphs import SHAPE, convolve, graph_of, image, network, run


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


@pytest.mark.parametrize(("shape", "mode"), [((1, 8, 1, 1), "DCR"), ((1,), "CRD")])
def test_pixel_shuffles_move_runs_of_channels_where_all_that_makes_them_can_be_reordered(shape, mode):
    """A constant of each channel can; one number for all is left alone, and the shuffle with it."""
    graph = graph_of((1, 3, 4, 6))
    made = convolve(graph, "image", image(1, (8, 3, 3, 3)), image(2, (8,)))
    made = graph.add("Add", [made, graph.weight("added", image(3, shape))], (1, 8, 4, 6))
    made = graph.add("Sigmoid", [made], (1, 8, 4, 6))
    graph.finish(graph.add("DepthToSpace", [made], (1, 2, 8, 12), blocksize=2, mode="CRD"), "y")
    x = image(0, (1, 3, 4, 6))
    before = run(graph, x)[0]
    shuffle_blocks(graph)
    assert graph.producer("y").attributes["mode"] == mode
    np.testing.assert_allclose(run(graph, x)[0], before, rtol=1e-6)


@pytest.mark.parametrize(("size", "stride", "op"), [(1, 1, "Reshape"), (1, 2, "Conv"), (3, 1, "Conv")])
def test_a_convolution_of_single_pixels_is_a_matrix_product(size, stride, op):
    graph = graph_of((1, 16, 8, 64))
    made = convolve(graph, "image", image(1, (6, 16, size, size)), image(2, (6,)))
    graph.finish(made, "y")
    node = graph.producer("y")
    node.attributes = node.attributes | {"strides": [stride, stride], "pads": [0, 0, 0, 0]}
    graph.shapes["y"] = (1, 6, *((side - size) // stride + 1 for side in (8, 64)))
    x = image(0, (1, 16, 8, 64))
    before = run(graph, x)[0]
    to_product(graph, node)
    assert graph.producer("y").op == op
    np.testing.assert_allclose(run(graph, x)[0], before, rtol=1e-5, atol=1e-6)

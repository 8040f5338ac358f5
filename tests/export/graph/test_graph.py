"""A graph keeps count of who makes and who takes each value, whatever is done to it."""

import time

import numpy as np
import pytest

from export.graph.graph import Graph
from export.graph.image_graph import trace
from export.graph.rewrite import fold_norms, trim_kernels
from export.int8.before_channels_last import means_to_pools, shuffle_blocks, spread_factors, spread_gates
from export.int8.calibration import halves_of
from export.int8.integer_forms import with_integer_forms
from export.int8.shifts import carry_shifts, to_relu
from tests.support.graphs import SHAPE, graph_of, image, network, run

PIXELS = (1, 2, 3, 4)


def assert_indexed(graph):
    """What the index says is what one finds by looking at every node."""
    names = {name for node in graph.nodes for name in (*node.inputs, node.output)} | graph.shapes.keys()
    for name in names:
        makers = [node for node in graph.nodes if node.output == name]
        assert makers == ([] if graph.producer(name) is None else [graph.producer(name)])
        assert {node for node in graph.nodes if name in node.inputs} == set(graph.consumers(name))


@pytest.mark.parametrize("name", ["v1", "rt", "lmnet"])
def test_the_index_holds_through_every_rewrite(name):
    graph = trace(with_integer_forms(network(name)), SHAPE)
    to_relu(graph, halves_of(graph, [image()]))
    steps = fold_norms, trim_kernels, carry_shifts, means_to_pools, spread_factors, spread_gates, shuffle_blocks
    for step in steps:
        step(graph)
        assert_indexed(graph)
    assert_indexed(graph.copy())


def test_look_ups_do_not_read_all_nodes():
    graph, count = graph_of((1,)), 20_000
    value = "image"
    for _ in range(count):
        value = graph.add("Relu", [value], (1,))
    start = time.perf_counter()
    for node in graph.nodes:
        assert graph.producer(node.output) is node
        assert node in graph.consumers(node.inputs[0])
    assert time.perf_counter() - start < 2  # by reading all nodes: minutes


@pytest.fixture
def graph():
    """image -> Relu -> Neg -> "y"; the ReLU is the output "x" too."""
    graph = graph_of(PIXELS)
    middle = graph.add("Relu", ["image"], PIXELS)
    graph.finish(graph.add("Neg", [middle], PIXELS), "y")
    graph.finish(middle, "x")
    return graph


def values(graph):
    return dict(zip(graph.outputs, run(graph, np.arange(24, dtype=np.float32).reshape(PIXELS) - 9), strict=True))


def test_outputs_have_their_names(graph):
    assert graph.outputs == ["y", "x"]
    assert_indexed(graph)
    np.testing.assert_array_equal(values(graph)["y"], -values(graph)["x"])


def test_what_supplants_a_node_stands_in_its_place_under_its_name(graph):
    before = values(graph)
    relu = graph.producer("x")
    with graph.before(relu):
        twice = graph.add("Add", ["image", "image"], PIXELS)
        kept = graph.add("Relu", [twice], PIXELS)
    graph.supplant(relu, kept)
    assert [node.op for node in graph.nodes] == ["Add", "Relu", "Neg"]
    assert graph.outputs == ["y", "x"]
    assert_indexed(graph)
    for name, value in values(graph).items():
        np.testing.assert_array_equal(value, 2 * before[name])


def test_a_value_that_two_take_has_no_only_consumer(graph):
    assert graph.only_consumer("x") is None  # an output
    assert graph.only_consumer("image") is graph.producer("x")
    graph.finish(graph.add("Neg", ["image"], PIXELS), "z")
    assert graph.only_consumer("image") is None


def test_a_node_that_takes_a_value_twice_is_one_consumer():
    graph = graph_of(PIXELS)
    graph.finish(graph.add("Mul", ["image", "image"], PIXELS), "y")
    assert len(graph.consumers("image")) == 1
    graph.replace("image", graph.weight("two", np.full(PIXELS, 2.0)))
    assert graph.consumers("image") == ()
    assert_indexed(graph)


def test_a_copy_changes_by_itself(graph):
    other = graph.copy()
    other.rewire(other.producer("y"), ["image"])
    other.outputs.remove("x")
    assert_indexed(other)
    assert_indexed(graph)
    assert graph.producer("y").inputs == ("x",)
    assert graph.outputs == ["y", "x"]


def test_what_no_output_needs_is_swept(graph):
    graph.weight("unused", np.ones(3))
    graph.outputs.remove("x")
    graph.rewire(graph.producer("y"), ["image"])
    graph.sweep()
    assert [node.op for node in graph.nodes] == ["Neg"]
    assert graph.weights == {}
    assert_indexed(graph)


def test_constants_have_names_and_types_of_their_own():
    graph = Graph()
    names = [graph.weight("w", values) for values in (np.ones(2), np.float32(3), np.ones((2, 2), np.int64)[:, 0])]
    assert len(set(names)) == 3
    assert [graph.weights[name].values.dtype for name in names] == [np.float32, np.float32, np.int64]
    assert [graph.weights[name].values.shape for name in names] == [(2,), (), (2,)]
    assert all(graph.weights[name].values.flags.c_contiguous for name in names)

"""Integer operations with the channels last: the integers of the pairs, and no sum that overflows."""

import numpy as np
import pytest

from export.int8.channels_last import integer_operations
from export.int8.integers import Params, kernel_integers
from export.int8.pairs import quantised
from export.int8.prepare import prepare
from tests.support.graphs import SHAPE, convolve, graph_of, image, join_graph, network, run


def extreme_graph():
    """A convolution whose inputs and weights are all as large as they can be: graph, and its float result."""
    graph = graph_of((1, 32, 4, 16))
    graph.add("Relu", ["image"], (1, 32, 4, 16))
    kernel = np.where(np.arange(16)[:, None, None, None] % 2, -1.0, 1.0) * np.ones((16, 32, 3, 3))
    graph.finish(convolve(graph, "relu_1", kernel), "sum")
    return graph


def test_the_largest_sums_do_not_saturate():
    """255 * 64 twice in a row, with either sign: with 8-bit kernels AVX2 would cut the sums off."""
    graph = extreme_graph()
    ranges = {"relu_1": (0.0, 1.0), "sum": (-288.0, 288.0)}
    pairs = quantised(graph, ["sum"], ranges)
    ones = np.ones((1, 32, 4, 16), np.float32)
    want = run(graph, ones)[0]
    step = Params.of(-288, 288).scale
    for made in (pairs, integer_operations(pairs)):
        np.testing.assert_allclose(run(made, ones)[0], want, atol=0.51 * step)


def test_integers_are_those_of_a_numpy_reference():
    """One 3x3 convolution with bias and ReLU: x, kernel and sum as integers, then rounded once."""
    rng = np.random.default_rng(3)
    graph = graph_of((1, 4, 6, 8))
    graph.add("Relu", ["image"], (1, 4, 6, 8))
    kernel, bias = rng.normal(size=(5, 4, 3, 3)).astype(np.float32), rng.normal(size=5).astype(np.float32)
    conv = convolve(graph, "relu_1", kernel, bias)
    graph.finish(graph.add("Relu", [conv], (1, 5, 6, 8)), "result")
    ranges = {"relu_1": (0.0, 3.0), "result": (0.0, 9.0), conv: (-9.0, 9.0)}
    x = rng.uniform(0, 3, (1, 4, 6, 8)).astype(np.float32)

    inner, outer = Params.of(0, 3), Params.of(0, 9)
    integers, scale = kernel_integers(kernel)
    padded = np.pad(inner.to_integers(x).astype(np.int64), ((0, 0), (0, 0), (1, 1), (1, 1)))
    steps = scale * inner.scale
    sums = np.rint(bias / steps).astype(np.int64)[:, None, None] * np.ones((5, 6, 8), np.int64)
    for i in range(3):
        for j in range(3):
            window = padded[0, :, i : i + 6, j : j + 8]
            sums += np.einsum("oc,chw->ohw", integers[:, :, i, j].astype(np.int64), window)
    want = np.clip(np.rint(sums * steps[:, None, None] / outer.scale), 0, 255) * outer.scale

    got = run(integer_operations(quantised(graph, [conv], ranges)), x)[0][0]
    assert np.mean(np.abs(got - want) > outer.scale / 2) < 0.01  # a tie may fall to either side
    np.testing.assert_allclose(got, want, atol=outer.scale * 1.01)


@pytest.mark.parametrize("name", ["v1", "rt", "lmnet"])
def test_integer_operations_give_the_integers_of_the_pairs(name):
    made = prepare(network(name, 16 if name == "rt" else 4), SHAPE, [image()])
    want, got = run(made.pairs(), image(1)), run(made.model(), image(1))
    for a, b in zip(got, want, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-2 * np.abs(b).max())
        assert np.abs(a - b).mean() < 1e-3 * np.abs(b).max()


@pytest.mark.parametrize(("widths", "op"), [((19.0, 20.0), "Concat"), ((1.0, 20.0), "QLinearConcat")])
def test_parts_of_a_join_share_a_scale_unless_few_steps_would_be_left(widths, op):
    graph, _, ranges = join_graph(widths=widths)
    lowered = integer_operations(quantised(graph, [n.output for n in graph.nodes if n.op == "Conv"], ranges))
    assert [node.op for node in lowered.nodes if "Concat" in node.op] == [op]
    x = np.abs(image(0, (1, 4, 8, 8)))
    want, got = run(graph, x, ["sum"])[0], run(lowered, x, ["sum"])[0]
    assert np.abs(np.clip(want, -9, 9) - got).mean() < 0.15


def test_a_relu_beside_a_part_that_reaches_below_zero_ends_at_zero():
    graph, (part, _), ranges = join_graph(widths=(19.0, 20.0))
    join = next(node for node in graph.nodes if node.op == "Concat")
    with graph.before(join):
        below = graph.add("Add", [part, graph.weight("shift", np.full((1, 3, 1, 1), -2.0))], graph.shapes[part])
    graph.rewire(join, [below, join.inputs[1]])
    ranges |= {below: (-2.0, 17.0), join.output: (-2.0, 20.0)}
    x = np.abs(image(0, (1, 4, 8, 8)))
    want = run(graph, x, ["sum"])[0]
    whole = quantised(graph, [node.output for node in graph.nodes if node.op == "Conv"], ranges)
    got = run(integer_operations(whole), x, ["sum"])[0]
    assert np.abs(np.clip(want, -9, 9) - got).mean() < 0.15

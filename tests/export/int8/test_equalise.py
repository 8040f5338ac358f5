"""Channels that reach as far as each other, and results that stay."""

import numpy as np
import pytest

from export.graph.image_graph import trace
from export.graph.rewrite import fold_norms
from export.int8.before_channels_last import shuffle_blocks
from export.int8.calibration import find_widths, floating, halves_of
from export.int8.equalise import equalise, tied_channels
from export.int8.integer_forms import with_integer_forms
from export.int8.shifts import carry_shifts, to_relu
from tests.support.graphs import SHAPE, convolve, graph_of, image, join_graph, network, run


def test_parts_of_a_join_reach_as_far_as_the_one_that_stays_and_nothing_else_changes():
    graph, parts, _ = join_graph()
    x = image(0, (1, 4, 8, 8))
    before = run(graph, x)
    join = next(node.output for node in graph.nodes if node.op == "Concat")
    widths = find_widths(graph, [*parts, join], [x])
    equalise(graph, widths)
    after = find_widths(graph, parts, [x])
    alive = widths[parts[0]] > 0
    assert alive.any()
    np.testing.assert_allclose(after[parts[0]][alive], widths[parts[1]].max(), rtol=1e-3)  # free: made wider
    np.testing.assert_allclose(after[parts[1]], widths[parts[1]], rtol=1e-5)  # a result shows it
    for kept, equal in zip(before, run(graph, x), strict=True):
        np.testing.assert_allclose(equal, kept, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["v1", "rt", "lmnet"])
def test_equal_channels_change_nothing_but_themselves(name):
    graph = trace(with_integer_forms(network(name)), SHAPE)
    images = [image()]
    to_relu(graph, halves_of(graph, images))
    fold_norms(graph)
    carry_shifts(graph)
    shuffle_blocks(graph)
    numbers = tied_channels(graph)
    ends = [n.output for n in graph.nodes if n.op == "Relu" and len(set(numbers[n.output])) == len(numbers[n.output])]
    ends = [name for name in ends if numbers[name].all()]
    assert len(ends) > 10
    before, widths = run(floating(graph), images[0]), find_widths(graph, ends, images)
    equalise(graph, widths)
    for kept, equal in zip(before, run(floating(graph), images[0]), strict=True):
        np.testing.assert_allclose(equal, kept, atol=1e-4 * np.abs(kept).max())

    def unequal(widths):
        return np.mean([np.std(width) / np.mean(width) for width in widths.values()])

    assert unequal(find_widths(graph, ends, images)) < 0.5 * unequal(widths)


def test_channels_of_a_pixel_shuffle_are_tied_as_they_meet():
    for mode, together in (("CRD", [[0, 1, 2, 3], [4, 5, 6, 7]]), ("DCR", [[0, 2, 4, 6], [1, 3, 5, 7]])):
        graph = graph_of((1, 3, 4, 4))
        first = convolve(graph, "image", np.ones((8, 3, 1, 1)))
        moved = graph.add("DepthToSpace", [first], (1, 2, 8, 8), blocksize=2, mode=mode)
        graph.finish(convolve(graph, moved, np.ones((1, 2, 1, 1))), "y")
        numbers = tied_channels(graph)
        assert [set(numbers[first][group]) for group in together] == [{number} for number in numbers[moved]]
        assert len(set(numbers[moved])) == 2

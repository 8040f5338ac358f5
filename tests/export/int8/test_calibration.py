"""What values are on the calibration scans."""

import numpy as np

from export.graph.image_graph import trace
from export.int8.calibration import best_range, halves_of
from tests.support.graphs import SHAPE, image, network, run


def test_what_leaky_relus_take():
    graph = trace(network("lmnet"), SHAPE)
    halves = halves_of(graph, [image()])
    name, found = next(iter(halves.items()))
    graph.outputs = [graph.producer(name).inputs[0]]
    x = run(graph, image())[0].transpose(1, 0, 2, 3).reshape(len(found.above), -1).astype(np.float64)
    above, below = np.maximum(x, 0), np.maximum(-x, 0)
    wanted = (above.mean(1), above.var(1), below.mean(1), below.var(1), below.max(1))
    for got, want in zip(found, wanted, strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-4, atol=1e-6)


def test_ranges_cut_rare_large_values_and_hold_zero():
    values = np.abs(np.random.default_rng(0).normal(size=16000))
    values[7] = 10
    low, high = best_range(values)
    assert low == 0
    assert 2 < high < 10
    assert best_range(np.linspace(-1, 1, 1000)) == (-1.0, 1.0)
    assert best_range(np.zeros(10)) == (0.0, 0.0)

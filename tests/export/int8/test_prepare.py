"""A network on its way to integers."""

import numpy as np

from export.graph.image_graph import trace
from export.int8.calibration import floating
from export.int8.prepare import prepare
from tests.support.graphs import SHAPE, image, network, run


def test_int8_stays_near_float(prepared):
    want = run(floating(trace(network(), SHAPE)), image(), ["probabilities"])
    got = run(prepared.model(), image(), ["probabilities"])
    assert 1e-7 < np.abs(got[0] - want[0]).mean() < 0.01


def test_layers_left_in_float_are_float(prepared):
    layer = "encoder.0.first.conv"
    kernels = {node.op for node in prepared.pairs([layer]).nodes}
    every = [node for node in prepared.pairs().nodes if node.op == "DequantizeLinear" and "axis" in node.attributes]
    fewer = [
        node for node in prepared.pairs([layer]).nodes if node.op == "DequantizeLinear" and "axis" in node.attributes
    ]
    assert len(every) - len(fewer) == 2  # kernel and bias
    assert "Conv" in kernels
    run(prepared.model([layer]), image())


def test_the_same_network_gives_the_same_bytes(prepared):
    again = prepare(network(), SHAPE, [image()])
    assert prepared.model() == again.model()

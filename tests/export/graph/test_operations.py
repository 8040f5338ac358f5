"""What is taken for granted of operations: true in ONNX Runtime, and written down once."""

import ast

import numpy as np
import pytest

from export.graph.operations import OPERATIONS
from export.int8.calibration import floating
from export.int8.channels_last import integer_operations
from export.int8.integers import Params
from tests.support.graphs import convolve, graph_of, image, run
from tests.support.paths import ROOT

PIXELS = (1, 4, 6, 8)
POOL = {"kernel_shape": [3, 3], "strides": [1, 1]}
NEAREST = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}


def constant(graph, values):
    return graph.weight("constant", np.asarray(values))


EXAMPLES = {  # of the graph, two maps of PIXELS, to the output of the operation
    "Conv": lambda g, x, y: convolve(g, x, image(2, (4, 4, 3, 3))),
    "Add": lambda g, x, y: g.add("Add", [x, y], PIXELS),
    "Mul": lambda g, x, y: g.add("Mul", [x, y], PIXELS),
    "Concat": lambda g, x, y: g.add("Concat", [x, y], (1, 8, 6, 8), axis=1),
    "Relu": lambda g, x, y: g.add("Relu", [x], PIXELS),
    "LeakyRelu": lambda g, x, y: g.add("LeakyRelu", [x], PIXELS, alpha=0.1),
    "Sigmoid": lambda g, x, y: g.add("Sigmoid", [x], PIXELS),
    "Clip": lambda g, x, y: g.add("Clip", [x, *(constant(g, np.float32(end)) for end in (-0.5, 0.5))], PIXELS),
    "AveragePool": lambda g, x, y: g.add("AveragePool", [x], (1, 4, 4, 6), **POOL),
    "GlobalAveragePool": lambda g, x, y: g.add("GlobalAveragePool", [x], (1, 4, 1, 1)),
    "SoftPool": lambda g, x, y: g.add("SoftPool", [x], (1, 4, 3, 4)),
    "Expand": lambda g, x, y: g.add("Expand", [x, g.integers(2, 4, 6, 8)], (2, 4, 6, 8)),
    "Slice": lambda g, x, y: g.slice(x, (1, 4, 6, 3), 3, 2, 5),
    "Pad": lambda g, x, y: g.add("Pad", [x, g.integers(0, 0, 1, 2, 0, 0, 0, 1)], (1, 4, 7, 11)),
    "Resize": lambda g, x, y: g.add("Resize", [x, "", constant(g, [1.0, 1, 2, 3])], (1, 4, 12, 24), **NEAREST),
    "DepthToSpace": lambda g, x, y: g.add("DepthToSpace", [x], (1, 1, 12, 16), blocksize=2, mode="CRD"),
    "Reshape": lambda g, x, y: g.reshape(x, (1, 8, 24)),
    "Transpose": lambda g, x, y: g.add("Transpose", [x], (1, 8, 4, 6), perm=[0, 3, 1, 2]),
}


def result(op, x):
    """What an operation makes of a map, and of a fixed one where it takes two."""
    graph = graph_of(PIXELS)
    other = graph.weight("other", image(1, PIXELS))
    graph.finish(EXAMPLES[op](graph, graph.add("Identity", ["image"], PIXELS), other), "y")
    return run(floating(graph), x)[0]


def those_with(trait):
    return [op for op, known in OPERATIONS.items() if getattr(known, trait)]


def test_every_operation_has_an_example():
    assert EXAMPLES.keys() == OPERATIONS.keys()


@pytest.mark.parametrize("op", those_with("elementwise"))
def test_elementwise_operations_see_single_numbers(op):
    x = image(0, PIXELS)
    order = np.random.default_rng(0).permutation(x.size)
    np.testing.assert_allclose(
        result(op, x.reshape(-1)[order].reshape(PIXELS)).reshape(-1), result(op, x).reshape(-1)[order], rtol=1e-6
    )


@pytest.mark.parametrize("op", those_with("moves"))
def test_moved_numbers_are_those_that_were_there(op):
    x = image(0, PIXELS)
    assert set(result(op, x).reshape(-1).tolist()) <= {*x.reshape(-1).tolist(), 0.0}


@pytest.mark.parametrize("op", those_with("passes_factor"))
def test_factors_of_channels_pass(op):
    x, factor = image(0, PIXELS), np.float32([0.5, 1, 3, 7]).reshape(1, 4, 1, 1)
    np.testing.assert_allclose(result(op, factor * x), factor * result(op, x), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("op", those_with("passes_shift"))
def test_shifts_of_channels_pass(op):
    x, shift = image(0, PIXELS), np.float32([0.5, -1, 3, 7]).reshape(1, 4, 1, 1)
    behind = np.concatenate([shift, 0 * shift], 1) if op == "Concat" else shift
    np.testing.assert_allclose(result(op, x + shift), result(op, x) + behind, rtol=1e-5, atol=1e-5)


def pairs(graph, value, params):
    """A value as integers, dequantised."""
    names = [graph.weight("scale", np.float32(params.scale)), graph.weight("zero", np.uint8(params.zero))]
    whole = graph.add("QuantizeLinear", [value, *names], graph.shapes[value])
    return graph.add("DequantizeLinear", [whole, *names], graph.shapes[value])


def kernel_pairs(graph, scale):
    """Kernel and bias of a convolution of what is integers of `scale`, as integers, dequantised."""
    for name, shape, step, kind in (("kernel", (4, 4, 3, 3), 0.01, np.int8), ("bias", (4,), 0.01 * scale, np.int32)):
        values = {name: np.random.default_rng(3).integers(-60, 60, shape).astype(kind)}
        values |= {"step": np.full(4, step), "zero": np.zeros(4, kind)}
        names = [graph.weight(*item) for item in values.items()]
        yield graph.add("DequantizeLinear", names, shape, axis=0)


@pytest.mark.parametrize("op", those_with("integer"))
def test_integer_forms_compute_what_the_pairs_do(op):
    graph, params = graph_of(PIXELS), Params.of(-4, 4)
    x = pairs(graph, graph.add("Identity", ["image"], PIXELS), params)
    y = pairs(graph, graph.add("Neg", ["image"], PIXELS), params)
    parts = list(kernel_pairs(graph, params.scale))
    made = EXAMPLES[op](graph, x, y)
    if op == "Conv":
        graph.rewire(graph.producer(made), [x, *parts])
    graph.finish(pairs(graph, made, Params.of(-9, 9)), "y")
    lowered = integer_operations(graph)
    assert f"QLinear{op}" in [node.op for node in lowered.nodes]
    want, got = run(graph, image(0, PIXELS))[0], run(lowered, image(0, PIXELS))[0]
    np.testing.assert_allclose(got, want, atol=1.01 * Params.of(-9, 9).scale)


def test_operations_are_listed_nowhere_else():
    """A list of names in a rewrite would say a second time what an operation does."""
    for path in sorted((ROOT / "export").glob("*/*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Tuple | ast.List | ast.Set):
                names = [
                    part.value for part in node.elts if isinstance(part, ast.Constant) and part.value in OPERATIONS
                ]
                assert len(names) < 2, f"{path}:{node.lineno}: {names}: to be a trait in operations.py"

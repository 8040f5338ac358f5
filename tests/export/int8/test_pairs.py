"""Integers of the INT8 graph: what they are, that they cannot overflow, and that rewriting keeps the numbers."""

import dataclasses

import numpy as np
import pytest
import torch
from torch import nn

from export.graph.graph import Graph, Node, to_model
from export.graph.image_graph import Outputs, trace
from export.graph.rewrite import fold_norms, is_unpadded
from export.int8 import calibration
from export.int8.calibration import find_widths, halves_of
from export.int8.channels_last import integer_operations
from export.int8.equalise import equalise, tied_channels
from export.int8.integer_forms import with_integer_forms
from export.int8.layout import shuffle_blocks, spread_gates
from export.int8.pairs import LARGEST, Params, kernel_integers, quantised
from export.int8.prepare import prepare
from export.int8.shifts import Halves, carry_shifts, shift_of, to_relu
from mos_model.networks.config import named_config
from mos_model.networks.network import ImageOutput, build_image_network
from runtime.compute.sessions import open_session
from tests.support.models import randomise

SHAPE = (1, 13, 32, 64)


def run(graph, image, names=None):
    model = graph if isinstance(graph, bytes) else to_model(graph).SerializeToString()
    return open_session(model, threads=2).run(names, {"image": image})


def image(seed=0, shape=SHAPE):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def network(name="v1", channels=4):
    torch.manual_seed(0)
    net = randomise(build_image_network(named_config(name, channels)))
    for part in net.modules():
        if isinstance(part, nn.BatchNorm2d):
            part.weight.data.abs_()
    return Outputs(net)


@pytest.fixture(scope="module")
def prepared():
    return prepare(network(), SHAPE, [image()])


@pytest.mark.parametrize(("low", "high"), [(0, 5), (-3, 5), (-7, 0), (2, 6), (0, 0)])
def test_zero_is_met_exactly_and_values_within_half_a_step(low, high):
    params = Params.of(low, high)
    assert 0 <= params.zero <= 255
    assert params.to_integers(np.zeros(1))[0] == params.zero
    values = np.linspace(low, high, 1000)
    back = (params.to_integers(values).astype(float) - params.zero) * params.scale
    np.testing.assert_allclose(back, values, atol=params.scale * 0.501 + 1e-5, rtol=0)


def test_kernels_have_seven_bits_and_a_scale_for_each_output():
    kernel = np.random.default_rng(0).normal(size=(6, 3, 3, 3)) * np.logspace(-3, 3, 6)[:, None, None, None]
    kernel[2] = 0
    integers, scale = kernel_integers(kernel)
    assert integers.dtype == np.int8
    assert np.abs(integers).max() == LARGEST
    back = integers * scale[:, None, None, None]
    assert (np.abs(back - kernel).reshape(6, -1).max(1) <= scale * 0.501).all()
    assert 2 * 255 * LARGEST < 2**15  # two products in the 16-bit sum of processors without VNNI


def extreme_graph():
    """A convolution whose inputs and weights are all as large as they can be: graph, and its float result."""
    graph = Graph(inputs=["image"], shapes={"image": (1, 32, 4, 16)})
    graph.add("Relu", ["image"], (1, 32, 4, 16))
    kernel = np.where(np.arange(16)[:, None, None, None] % 2, -1.0, 1.0) * np.ones((16, 32, 3, 3), np.float32)
    names = ["relu_1", graph.weight("kernel", np.float32(kernel))]
    pads = {"kernel_shape": [3, 3], "strides": [1, 1], "pads": [1, 1, 1, 1], "dilations": [1, 1], "group": 1}
    graph.finish(graph.add("Conv", names, (1, 16, 4, 16), **pads), "sum")
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
    graph = Graph(inputs=["image"], shapes={"image": (1, 4, 6, 8)})
    graph.add("Relu", ["image"], (1, 4, 6, 8))
    kernel, bias = rng.normal(size=(5, 4, 3, 3)).astype(np.float32), rng.normal(size=5).astype(np.float32)
    names = ["relu_1", graph.weight("kernel", kernel), graph.weight("bias", bias)]
    settings = {"kernel_shape": [3, 3], "strides": [1, 1], "pads": [1, 1, 1, 1], "dilations": [1, 1], "group": 1}
    conv = graph.add("Conv", names, (1, 5, 6, 8), **settings)
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


def join_graph(channels=(3, 5), widths=(1.0, 20.0)):
    """Two maps side by side before a convolution; another reads the first too, and an output the second."""
    rng = np.random.default_rng(0)
    graph = Graph(inputs=["image"], shapes={"image": (1, 4, 8, 8)})
    settings = {"kernel_shape": [1, 1], "strides": [1, 1], "pads": [0] * 4, "dilations": [1, 1], "group": 1}

    def convolution(x, i, o, size=1.0):
        kernel, bias = rng.normal(size=(o, i, 1, 1)) * size, rng.normal(size=o) * size
        names = [x, graph.weight("kernel", np.float32(kernel)), graph.weight("bias", np.float32(bias))]
        return graph.add("Conv", names, (1, o, 8, 8), **settings)

    x = graph.add("Relu", ["image"], (1, 4, 8, 8))
    sizes = zip(channels, widths, strict=True)
    parts = [graph.add("Relu", [convolution(x, 4, c, width / 10)], (1, c, 8, 8)) for c, width in sizes]
    join = graph.add("Concat", parts, (1, sum(channels), 8, 8), axis=1)
    graph.finish(convolution(join, sum(channels), 6), "sum")
    graph.finish(convolution(parts[0], channels[0], 2), "beside")
    graph.finish(graph.add("Neg", [parts[1]], graph.shapes[parts[1]]), "other")
    ranges = {"relu_1": (0.0, 3.0), "sum": (-9.0, 9.0), "beside": (-5.0, 5.0), join: (0.0, max(widths))}
    for part, width in zip(parts, widths, strict=True):
        ranges |= {part: (0.0, width), graph.producer(part).inputs[0]: (-width, width)}
    return graph, parts, ranges


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
    before, widths = run(calibration._floating(graph), images[0]), find_widths(graph, ends, images)
    equalise(graph, widths)
    for kept, equal in zip(before, run(calibration._floating(graph), images[0]), strict=True):
        np.testing.assert_allclose(equal, kept, atol=1e-4 * np.abs(kept).max())

    def unequal(widths):
        return np.mean([np.std(width) / np.mean(width) for width in widths.values()])

    assert unequal(find_widths(graph, ends, images)) < 0.5 * unequal(widths)


def test_channels_of_a_pixel_shuffle_are_tied_as_they_meet():
    settings = {"kernel_shape": [1, 1], "strides": [1, 1], "pads": [0] * 4, "dilations": [1, 1], "group": 1}
    for mode, together in (("CRD", [[0, 1, 2, 3], [4, 5, 6, 7]]), ("DCR", [[0, 2, 4, 6], [1, 3, 5, 7]])):
        graph = Graph(inputs=["image"], shapes={"image": (1, 3, 4, 4)})
        first = graph.add("Conv", ["image", graph.weight("kernel", np.ones((8, 3, 1, 1)))], (1, 8, 4, 4), **settings)
        moved = graph.add("DepthToSpace", [first], (1, 2, 8, 8), blocksize=2, mode=mode)
        graph.finish(
            graph.add("Conv", [moved, graph.weight("k", np.ones((1, 2, 1, 1)))], (1, 1, 8, 8), **settings), "y"
        )
        numbers = tied_channels(graph)
        assert [set(numbers[first][group]) for group in together] == [{number} for number in numbers[moved]]
        assert len(set(numbers[moved])) == 2


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
    shift = np.full((1, 3, 1, 1), -2, np.float32)
    join = next(node for node in graph.nodes if node.op == "Concat")
    below = graph.new_name("add", graph.shapes[part])
    graph.nodes.insert(graph.nodes.index(join), Node("Add", [part, graph.weight("shift", shift)], below))
    join.inputs[0] = below
    ranges |= {below: (-2.0, 17.0), join.output: (-2.0, 20.0)}
    x = np.abs(image(0, (1, 4, 8, 8)))
    want = run(graph, x, ["sum"])[0]
    whole = quantised(graph, [node.output for node in graph.nodes if node.op == "Conv"], ranges)
    got = run(integer_operations(whole), x, ["sum"])[0]
    assert np.abs(np.clip(want, -9, 9) - got).mean() < 0.15


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


def test_int8_stays_near_float(prepared):
    want = run(to_model(calibration._floating(trace(network(), SHAPE))).SerializeToString(), image(), ["probabilities"])
    got = run(prepared.model(), image(), ["probabilities"])
    assert 1e-7 < np.abs(got[0] - want[0]).mean() < 0.01


def test_layers_left_in_float_are_float(prepared):
    layer = "resBlock1.conv2"
    kernels = {node.op for node in prepared.pairs([layer]).nodes}
    every = [node for node in prepared.pairs().nodes if node.op == "DequantizeLinear" and "axis" in node.attributes]
    fewer = [
        node for node in prepared.pairs([layer]).nodes if node.op == "DequantizeLinear" and "axis" in node.attributes
    ]
    assert len(every) - len(fewer) == 2  # kernel and bias
    assert "Conv" in kernels
    run(prepared.model([layer]), image())


def test_first_last_and_meta_kernel_geometry_stay_in_float(prepared):
    assert "logits3" not in prepared.layers
    assert "downCntx.conv1" not in prepared.layers
    assert not any("near" in layer for layer in prepared.layers)
    assert {"downCntx.conv2", "metaConv.conv2", "metaConv.joined", "upBlock4.conv4"} <= set(prepared.layers)
    assert len(prepared.layers["metaConv.joined"]) == 2
    assert len(prepared.layers["metaConv.conv2"]) == 8


def test_the_same_network_gives_the_same_bytes(prepared):
    again = prepare(network(), SHAPE, [image()])
    assert prepared.model() == again.model()


class Block(nn.Module):
    """Two padded convolutions with LeakyReLU before BatchNorm, joined and read by a 1x1."""

    def __init__(self):
        super().__init__()
        self.a, self.b = nn.Conv2d(3, 4, 3, padding=1), nn.Conv2d(4, 4, 3, padding=2, dilation=2)
        self.na, self.nb = nn.BatchNorm2d(4), nn.BatchNorm2d(4)
        self.join, self.features = nn.Conv2d(8, 3, 1), nn.Conv2d(8, 2, 1)

    def forward(self, x):
        a = self.na(nn.functional.leaky_relu(self.a(x), 0.0))
        b = self.nb(nn.functional.leaky_relu(self.b(a), 0.0))
        joined = torch.cat((a, b), 1)
        return ImageOutput(self.join(joined), self.features(joined))


@pytest.mark.parametrize("negative", [False, True])
def test_carried_shifts_change_nothing(negative):
    torch.manual_seed(1)
    block = randomise(Block())
    for norm in (block.na, block.nb):
        norm.weight.data.abs_()
        if negative:
            norm.weight.data[1] *= -1
    shape = (1, 3, 12, 16)
    graph = trace(Outputs(block), shape)
    nothing, something = np.zeros(4), np.ones(4)
    upper = Halves(nothing, something, nothing, nothing, nothing)
    want = run(graph, image(0, shape))
    to_relu(graph, {node.output: upper for node in graph.nodes if node.op == "LeakyRelu"})
    carry_shifts(graph)
    assert not any(node.op in ("BatchNormalization", "LeakyRelu") for node in graph.nodes)
    for a, b in zip(run(graph, image(0, shape)), want, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)


def test_a_join_before_a_convolution_without_border_takes_its_parts_without_shift():
    graph = trace(with_integer_forms(network("lmnet")), SHAPE)
    want = run(calibration._floating(graph), image())
    to_relu(graph, halves_of(graph, [image()]))
    fold_norms(graph)
    halfway = run(calibration._floating(graph), image())
    carry_shifts(graph)
    joins = [node for node in graph.nodes if node.op == "Concat" and is_unpadded(graph.consumers(node.output)[0])]
    assert len(joins) == 9
    assert all(shift_of(graph, graph.producer(part)) is None for node in joins for part in node.inputs)
    for a, b, c in zip(run(calibration._floating(graph), image()), halfway, want, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-4 * np.abs(b).max())
        assert np.abs(a - c).mean() < 0.1 * np.abs(c).max()


def test_what_leaky_relus_take():
    graph = trace(network("lmnet"), SHAPE)
    halves = calibration.halves_of(graph, [image()])
    name, found = next(iter(halves.items()))
    probe = dataclasses.replace(graph, outputs=[graph.producer(name).inputs[0]])
    x = run(probe, image())[0].transpose(1, 0, 2, 3).reshape(len(found.above), -1).astype(np.float64)
    above, below = np.maximum(x, 0), np.maximum(-x, 0)
    wanted = (above.mean(1), above.var(1), below.mean(1), below.var(1), below.max(1))
    for got, want in zip(found, wanted, strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-4, atol=1e-6)


class Drowned(nn.Module):
    """A block as the paper has them; channels 1 and 3 are hardly ever above zero, and made large again."""

    def __init__(self):
        super().__init__()
        self.conv, self.norm = nn.Conv2d(3, 4, 3, padding=1), nn.BatchNorm2d(4)
        self.last = nn.Conv2d(4, 3, 1)

    def forward(self, x):
        y = self.norm(nn.functional.leaky_relu(self.conv(x), 0.01))
        return ImageOutput(self.last(y), y)


@pytest.mark.parametrize("negative", [False, True])
def test_channels_below_zero_survive(negative):
    torch.manual_seed(0)
    block = Drowned().eval()
    block.conv.bias.data = torch.tensor([0.0, -9.0, 0.0, -30.0])
    block.norm.weight.data = torch.tensor([1.0, -150.0 if negative else 150.0, 1.0, 90.0])
    shape = (1, 3, 12, 16)
    graph = trace(Outputs(block), shape)
    want = run(graph, image(0, shape), ["features"])[0]
    to_relu(graph, calibration.halves_of(graph, [image(0, shape)]))
    assert not any(node.op == "LeakyRelu" for node in graph.nodes)
    got = run(graph, image(0, shape), ["features"])[0]
    error = np.sqrt(((got - want) ** 2).mean((0, 2, 3)))
    assert (error < 0.03 * want.std((0, 2, 3))).all()


def test_ranges_cut_rare_large_values_and_hold_zero():
    values = np.abs(np.random.default_rng(0).normal(size=16000))
    values[7] = 10
    low, high = calibration.best_range(values)
    assert low == 0
    assert 2 < high < 10
    assert calibration.best_range(np.linspace(-1, 1, 1000)) == (-1.0, 1.0)
    assert calibration.best_range(np.zeros(10)) == (0.0, 0.0)

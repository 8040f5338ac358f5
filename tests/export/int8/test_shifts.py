"""BatchNorms behind activations: ReLUs and shifts in their place."""

import numpy as np
import pytest
import torch
from torch import nn

from export.graph.convolutions import is_unpadded
from export.graph.image_graph import Outputs, trace
from export.graph.rewrite import fold_norms
from export.int8.calibration import floating, halves_of
from export.int8.integer_forms import with_integer_forms
from export.int8.shifts import Halves, carry_shifts, shift_of, to_relu
from mos_model.networks.image_output import ImageOutput
from tests.support.graphs import SHAPE, image, network, run
from tests.support.models import randomise


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
    want = run(floating(graph), image())
    to_relu(graph, halves_of(graph, [image()]))
    fold_norms(graph)
    halfway = run(floating(graph), image())
    carry_shifts(graph)
    joins = [node for node in graph.nodes if node.op == "Concat" and is_unpadded(graph.consumers(node.output)[0])]
    assert len(joins) == 9
    assert all(shift_of(graph, graph.producer(part)) is None for node in joins for part in node.inputs)
    for a, b, c in zip(run(floating(graph), image()), halfway, want, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-4 * np.abs(b).max())
        assert np.abs(a - c).mean() < 0.1 * np.abs(c).max()


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
    to_relu(graph, halves_of(graph, [image(0, shape)]))
    assert not any(node.op == "LeakyRelu" for node in graph.nodes)
    got = run(graph, image(0, shape), ["features"])[0]
    error = np.sqrt(((got - want) ** 2).mean((0, 2, 3)))
    assert (error < 0.03 * want.std((0, 2, 3))).all()

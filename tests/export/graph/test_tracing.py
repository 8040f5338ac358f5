"""What is traced and rewritten computes in ONNX Runtime what it computes in PyTorch."""

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from export.graph.graph import to_model
from export.graph.image_graph import trace
from export.graph.rewrite import fold_norms
from mos_model.networks.config import named_config
from mos_model.networks.network import build_image_network
from runtime.compute.sessions import open_session
from runtime.errors import SettingError
from tests.support.models import randomise

SHAPE = (1, 6, 16, 32)


class Two(nn.Module):
    """A function of an image as a network of two outputs."""

    def __init__(self, function, *modules):
        super().__init__()
        self.function, self.parts = function, nn.ModuleList(modules)

    def forward(self, x):
        y = self.function(x, *self.parts)
        return y, y * 1.0


def run(graph, x):
    session = open_session(to_model(graph).SerializeToString(), threads=2)
    return session.run(["probabilities", "features"], {"image": x.numpy()})


def check(network, fold=True, shape=SHAPE, tolerance=1e-5):
    """Compare with PyTorch; returns the graph."""
    network.eval()
    torch.manual_seed(1)
    x = torch.randn(shape)
    graph = trace(network, shape)
    if fold:
        fold_norms(graph)
    with torch.no_grad():
        want = network(x.clone())
    for a, b in zip(run(graph, x), want, strict=True):
        np.testing.assert_allclose(a, b.numpy(), atol=tolerance, rtol=1e-5)
    return graph


OPERATIONS = {
    "slices and concatenation": lambda x: torch.cat((x[:, 2:5], x[:, :1], x[:, -2:]), 1),
    "strides": lambda x: x[..., 1::2, ::2] - x[..., ::2, 1::2],
    "padding": lambda x: F.pad(x, (1, 2, 3, 0)),
    "constants": lambda x: 2 - 3 * x + x / 4 + 1 / x.exp(),
    "scaled difference": lambda x: torch.sub(x, x.sigmoid(), alpha=2) + torch.add(x, 1, alpha=3),
    "activations": lambda x: F.leaky_relu(x, 0.2) + torch.relu(x).relu_() + x.tanh() + x.sigmoid(),
    "limits": lambda x: x.clamp(-0.5, 0.5) + x.clamp(min=0.1) + x.clamp(max=0.2),
    "larger and smaller": lambda x: torch.maximum(x, x.exp()) + torch.minimum(x, x.tanh()),
    "nearest": lambda x: F.interpolate(x, scale_factor=(2.0, 1.0), mode="nearest"),
    "pixel shuffle": lambda x: F.pixel_shuffle(x[:, :4], 2),
    "shapes": lambda x: x.view(1, 2, 3, 16, 32).permute(0, 2, 3, 4, 1).reshape(1, 3, 16, 64),
    "mean": lambda x: x * x.mean((2, 3), keepdim=True) + x.mean(1, keepdim=True),
    "softmax of channels": lambda x: x.softmax(1),
    "softmax of a gate": lambda x: x.mean((2, 3), keepdim=True).softmax(1) * x,
    "softmax of a row": lambda x: x.softmax(-1),
    "average": lambda x: F.avg_pool2d(x, 3, 2, 1) + F.avg_pool2d(x, 3, 2, 1, count_include_pad=False),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_operations(name):
    check(Two(OPERATIONS[name]))


def test_large_values_do_not_overflow_in_softmax():
    check(Two(lambda x: (x * 1e4).softmax(1)))


@pytest.mark.parametrize(
    "conv",
    [
        nn.Conv2d(6, 4, 3, padding=2, dilation=2),
        nn.Conv2d(6, 4, (3, 5), stride=(1, 2), padding=(1, 2), bias=False),
        nn.Conv2d(6, 12, 3, groups=6),
        nn.ConvTranspose2d(6, 4, 2, stride=2),
    ],
)
def test_convolutions(conv):
    check(Two(lambda x, conv: conv(x), conv))


def test_an_operation_without_emitter_is_named():
    with pytest.raises(SettingError, match=r"uses aten.cumsum.default, which export/graph/emitters.py"):
        trace(Two(lambda x: x.cumsum(1)).eval(), SHAPE)


def norms(graph):
    return sum(node.op == "BatchNormalization" for node in graph.nodes)


def norm(c):
    return randomise(nn.BatchNorm2d(c))


def test_a_norm_folds_into_the_convolution_before():
    parts = nn.Conv2d(6, 4, 3, padding=1, bias=False), norm(4), nn.ReLU()
    graph = check(Two(lambda x, conv, norm, relu: relu(norm(conv(x))), *parts))
    assert norms(graph) == 0


def test_a_norm_folds_through_a_concatenation_into_the_convolution_after():
    def function(x, first, norm, second):
        y = F.leaky_relu(first(x))
        return second(torch.cat((x, norm(y), x), 1))

    graph = check(Two(function, nn.Conv2d(6, 4, 1), norm(4), nn.Conv2d(16, 5, 1)))
    assert norms(graph) == 0


@pytest.mark.parametrize("case", ["padded", "two consumers", "output", "twice"])
def test_a_norm_stays_where_folding_would_not_be_exact(case):
    def function(x, first, norm, second):
        y = norm(F.leaky_relu(first(x)))
        if case == "output":
            return y
        if case == "twice":
            return second(torch.cat((y, y), 1))
        return second(y) + (y if case == "two consumers" else 0)

    padding = 1 if case == "padded" else 0
    width = 8 if case == "twice" else 4
    second = nn.Conv2d(width, 4, 3 if padding else 1, padding=padding)
    graph = check(Two(function, nn.Conv2d(6, 4, 1), norm(4), second))
    assert norms(graph) == 1


def test_a_convolution_with_two_consumers_keeps_its_values():
    def function(x, conv, norm):
        y = conv(x)
        return y + norm(y)

    assert norms(check(Two(function, nn.Conv2d(6, 4, 1), norm(4)))) == 1


def test_a_kernel_that_is_used_twice_is_folded_once_for_each():
    conv = nn.Conv2d(6, 6, 3, padding=1)
    graph = check(Two(lambda x, conv, a, b: a(conv(x)) + b(conv(x)), conv, norm(6), norm(6)))
    assert norms(graph) == 0


@pytest.mark.parametrize("rounded", [False, True])
def test_kernels_that_float16_holds_are_stored_so(rounded):
    conv = nn.Conv2d(6, 4, 3)
    if rounded:
        conv.weight.data = conv.weight.data.half().float()
    graph = check(Two(lambda x, conv, norm: norm(conv(x)), conv, norm(4)))
    stored = {tensor.name: tensor.data_type for tensor in to_model(graph).graph.initializer}
    assert any(name.endswith(".half") for name in stored) == rounded


@pytest.mark.parametrize("name", ["lmnet", "b", "c", "d", "e", "rt"])
def test_networks_of_the_paper(name):
    class Outputs(nn.Module):
        def __init__(self):
            super().__init__()
            self.network = randomise(build_image_network(named_config(name, 4)))

        def forward(self, x):
            output = self.network(x)
            return output.logits.softmax(1), output.features

    check(Outputs(), shape=(1, 13, 32, 48), tolerance=5e-5)

"""BatchNorms inside convolutions and kernels without their borders of zeros compute the same."""

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from export.graph.blocked_forms import with_blocked_forms
from export.graph.image_graph import Outputs, trace
from export.graph.rewrite import trim_kernels
from mos_model.networks.registry import named_config
from tests.support.graphs import Two, check, run
from tests.support.models import randomise


class Taps(nn.Module):
    """Convolutions of one kernel, as the features; and the image as probabilities."""

    def __init__(self, taps, size, groups=1, **settings):
        super().__init__()
        kernel = torch.zeros(6, 6 // groups, size, size)
        for i, j in taps:
            kernel[..., i, j] = torch.randn(6, 6 // groups)
        self.register_buffer("kernel", kernel)
        self.settings = settings | {"groups": groups}

    def forward(self, x):
        return x * 1.0, F.conv2d(x, self.kernel, **self.settings)


TAPS = ([(0, 0)], [(0, 0), (1, 1)], [(1, 1), (1, 2)], [(2, 0), (1, 1)], [(2, 2)], [(1, 1)], [])


@pytest.mark.parametrize("settings", [{"padding": 1}, {"padding": 1, "stride": 2}, {"stride": 2}, {"padding": 2}, {}])
@pytest.mark.parametrize("taps", TAPS)
@pytest.mark.parametrize("groups", [1, 6])
def test_results_and_shapes_stay(taps, settings, groups):
    torch.manual_seed(0)
    x = torch.randn(1, 6, 8, 13)
    graph = trace(Taps(taps, 3, groups, **settings), tuple(x.shape))
    before = run(graph, x.numpy(), ["features"])[0]
    trim_kernels(graph)
    after = run(graph, x.numpy(), ["features"])[0]
    assert after.shape == before.shape
    np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("taps", "size"), [([(0, 1), (1, 1)], [2, 1]), ([(0, 0), (1, 1)], [2, 2]), ([(1, 1)], [1, 1])])
def test_rows_and_columns_of_zeros_are_cut(taps, size):
    graph = trace(Taps(taps, 3, padding=1), (1, 6, 8, 13))
    trim_kernels(graph)
    assert [node.attributes["kernel_shape"] for node in graph.nodes if node.op == "Conv"] == [size]


def test_the_geometry_of_the_meta_kernel_has_small_kernels():
    graph = trace(with_blocked_forms(Outputs(randomise(named_config("v1", 4).build_image_network()))), (1, 13, 32, 64))
    trim_kernels(graph)
    sizes = [n.attributes["kernel_shape"] for n in graph.nodes if n.op == "Conv" and "near" in n.inputs[1]]
    assert sorted(sizes) == [[1, 2]] * 2 + [[2, 1]] * 2 + [[2, 2]] * 4


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

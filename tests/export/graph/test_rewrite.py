"""Kernels without their borders of zeros compute the same."""

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from export.graph.blocked_forms import with_blocked_forms
from export.graph.image_graph import Outputs, trace
from export.graph.rewrite import trim_kernels
from mos_model.networks.config import named_config
from mos_model.networks.network import build_image_network
from tests.export.int8.test_pairs import run
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
    graph = trace(with_blocked_forms(Outputs(randomise(build_image_network(named_config("v1", 4))))), (1, 13, 32, 64))
    trim_kernels(graph)
    sizes = [n.attributes["kernel_shape"] for n in graph.nodes if n.op == "Conv" and "near" in n.inputs[1]]
    assert sorted(sizes) == [[1, 2]] * 2 + [[2, 1]] * 2 + [[2, 2]] * 4

"""What is traced computes in ONNX Runtime what it computes in PyTorch."""

import inspect

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from export.graph import tracing
from export.graph.image_graph import trace
from runtime.errors import SettingError
from tests.support.graphs import Two, check

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
        trace(Two(lambda x: x.cumsum(1)).eval(), (1, 6, 16, 32))


def test_the_tracer_is_given_its_emitters():
    """They know the tracer; did it know them, the two files would be a circle."""
    imports = [line for line in inspect.getsource(tracing).splitlines() if "import" in line]
    assert not any("emitters" in line for line in imports)

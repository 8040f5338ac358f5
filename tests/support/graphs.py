"""Small graphs and networks, and what ONNX Runtime makes of them, for the tests of the export."""

import numpy as np
import torch
from torch import nn

from export.graph.graph import Graph
from export.graph.image_graph import Outputs, trace
from export.graph.rewrite import fold_norms
from export.graph.serialise import onnx_bytes
from mos_model.networks.registry import named_config
from runtime.compute.sessions import open_session
from tests.support.models import randomise

SHAPE = (1, 13, 32, 64)
NAMES = ["probabilities", "features"]


def run(graph, image, names=None):
    """Results of a graph, or of the bytes of a model."""
    model = graph if isinstance(graph, bytes) else onnx_bytes(graph)
    return open_session(model, threads=2).run(names, {"image": image})


def image(seed=0, shape=SHAPE):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def network(name="v1", channels=4):
    torch.manual_seed(0)
    net = randomise(named_config(name, channels).build_image_network())
    for part in net.modules():
        if isinstance(part, nn.BatchNorm2d):
            part.weight.data.abs_()
    return Outputs(net)


class Two(nn.Module):
    """A function of an image as a network of two outputs."""

    def __init__(self, function, *modules):
        super().__init__()
        self.function, self.parts = function, nn.ModuleList(modules)

    def forward(self, x):
        y = self.function(x, *self.parts)
        return y, y * 1.0


def check(network, fold=True, shape=(1, 6, 16, 32), tolerance=1e-5):
    """Compare a traced network with PyTorch; returns its graph."""
    network.eval()
    torch.manual_seed(1)
    x = torch.randn(shape)
    graph = trace(network, shape)
    if fold:
        fold_norms(graph)
    with torch.no_grad():
        want = network(x.clone())
    for a, b in zip(run(graph, x.numpy(), NAMES), want, strict=True):
        np.testing.assert_allclose(a, b.numpy(), atol=tolerance, rtol=1e-5)
    return graph


def graph_of(shape):
    """A graph without nodes, whose input has that shape."""
    graph = Graph()
    graph.input("image", shape)
    return graph


def convolve(graph, x, kernel, bias=None):
    """Add a convolution that gives as many pixels as it takes."""
    size = kernel.shape[-1]
    names = [x, graph.weight("kernel", kernel)] + ([] if bias is None else [graph.weight("bias", bias)])
    window = {"kernel_shape": [size, size], "strides": [1, 1], "pads": [size // 2] * 4, "dilations": [1, 1], "group": 1}
    return graph.add("Conv", names, (1, len(kernel), *graph.shapes[x][2:]), **window)


def join_graph(channels=(3, 5), widths=(1.0, 20.0)):
    """Two maps side by side before a convolution; another reads the first too, and an output the second."""
    rng = np.random.default_rng(0)
    graph = graph_of((1, 4, 8, 8))

    def convolution(x, i, o, size=1.0):
        return convolve(graph, x, rng.normal(size=(o, i, 1, 1)) * size, rng.normal(size=o) * size)

    x = graph.add("Relu", ["image"], (1, 4, 8, 8))
    sizes = zip(channels, widths, strict=True)
    parts = [graph.add("Relu", [convolution(x, 4, c, width / 10)], (1, c, 8, 8)) for c, width in sizes]
    join = graph.add("Concat", parts, (1, sum(channels), 8, 8), axis=1)
    graph.finish(convolution(join, sum(channels), 6), "sum")
    graph.finish(convolution(parts[0], channels[0], 2), "beside")
    graph.finish(graph.add("Neg", [parts[1]], graph.shapes[parts[1]]), "other")
    ranges = {x: (0.0, 3.0), "sum": (-9.0, 9.0), "beside": (-5.0, 5.0), join: (0.0, max(widths))}
    for part, width in zip(parts, widths, strict=True):
        ranges |= {part: (0.0, width), graph.producer(part).inputs[0]: (-width, width)}
    return graph, parts, ranges

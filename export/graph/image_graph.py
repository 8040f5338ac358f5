"""The image network as an ONNX graph."""

import copy
from collections.abc import Iterator

import torch
from torch import Tensor, nn

from export.graph.blocked_forms import with_blocked_forms
from export.graph.emitters import EMITTERS
from export.graph.graph import Graph
from export.graph.rewrite import fold_norms, trim_kernels
from export.graph.serialise import onnx_bytes
from export.graph.tracing import Tracer


class Outputs(nn.Module):
    """The image network with what a bundle gives: probabilities and features."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        output = self.network(image)
        return output.logits.softmax(1), output.features


def trace(network: nn.Module, shape: tuple[int, ...]) -> Graph:
    """The graph of `network` (in evaluation mode) for an input "image" of `shape`.

    `network` returns (probabilities, features), which become the outputs of these names. Raises SettingError on
    an operation that has no emitter.
    """
    shadow = copy.deepcopy(network).to("meta").eval()
    real = dict(_tensors(network))
    tracer = Tracer(EMITTERS)
    image = torch.empty(shape, device="meta")
    tracer.input(image, "image")
    for key, tensor in _tensors(shadow):
        tracer.constants[id(tensor)] = (key, real[key].detach())
    with torch.no_grad(), tracer:
        outputs = shadow(image)
    for tensor, name in zip(outputs, ("probabilities", "features"), strict=True):
        tracer.rename(tensor, name)
    tracer.graph.sweep()
    return tracer.graph


def _tensors(module: nn.Module) -> Iterator[tuple[str, Tensor]]:
    yield from module.named_parameters()
    yield from module.named_buffers()


def image_bytes(network: nn.Module, shape: tuple[int, ...]) -> bytes:
    """The ONNX model of an image network for images of `shape` (1, channels, H, W), or of any size: see `any_size`."""
    graph = trace(with_blocked_forms(Outputs(network)), shape)
    fold_norms(graph)
    trim_kernels(graph)
    return onnx_bytes(graph)

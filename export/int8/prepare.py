"""The image network in integers: from the PyTorch module and calibration images to an ONNX model."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from torch import nn

from export.graph.convolutions import bias_of, set_bias
from export.graph.graph import Graph
from export.graph.image_graph import trace
from export.graph.rewrite import fold_norms, trim_kernels
from export.graph.serialise import onnx_bytes
from export.int8.before_channels_last import (
    means_to_pools,
    shuffle_blocks,
    spread_factors,
    spread_gates,
    to_product,
)
from export.int8.calibration import find_ranges, find_widths, halves_of
from export.int8.channels_last import integer_operations
from export.int8.equalise import equalise
from export.int8.integer_forms import with_integer_forms
from export.int8.integers import LARGEST, clipped, integer_values, last_convolutions, layers, roots
from export.int8.pairs import quantised
from export.int8.shifts import carry_shifts, to_relu
from runtime.classes import CLASSES


@dataclass(frozen=True)
class Prepared:
    """A network that is ready to be written in integers."""

    graph: Graph  # rewritten, in float
    layers: dict[str, list[str]]  # convolutions that may compute in integers (names of outputs), by layer
    ranges: dict[str, tuple[float, float]]  # of every value that may become integers

    def pairs(self, floats: Collection[str] = (), largest: int = LARGEST) -> Graph:
        """The graph with Quantize and Dequantize pairs; `floats` stay in float, `largest` see `quantised`."""
        chosen = {output for layer, outputs in self.layers.items() if layer not in floats for output in outputs}
        return quantised(self.graph, chosen, self.ranges, largest)

    def model(self, floats: Collection[str] = (), moving: float = 0.0) -> bytes:
        """The ONNX model in integer operations; `floats` stay in float, `moving` is added to that class's logit."""
        graph, last = self.pairs(floats), last_convolutions(self.graph)
        for node in graph.nodes:
            if node.output in last:
                bias = bias_of(graph, node)
                bias[-(len(bias) // len(CLASSES)) :] += moving  # the channels of a class lie together
                set_bias(graph, node, bias)
                to_product(graph, node)
        return onnx_bytes(integer_operations(graph))


def prepare(network: nn.Module, shape: tuple[int, ...], images: Sequence[np.ndarray]) -> Prepared:
    """Rewrite `network` for integers and find the ranges of its values on `images` (1, C, H, W).

    shape: to trace it at, that of the images or `any_size`.
    """
    graph = trace(with_integer_forms(network), shape)
    kernels = {node.output: node.inputs[1] for node in graph.nodes if node.op == "Conv"}
    to_relu(graph, halves_of(graph, images))
    fold_norms(graph)
    trim_kernels(graph)
    carry_shifts(graph)
    means_to_pools(graph)
    spread_factors(graph)
    spread_gates(graph)
    shuffle_blocks(graph)
    chosen = layers(graph)
    found: dict[str, list[str]] = {}
    for output in chosen:
        name = re.sub(r"_\d+$", "", kernels[output])  # that of a weight which several nodes take is numbered
        layer = name.removeprefix("network.").removesuffix(".weight")
        found.setdefault(layer, []).append(output)
    values = integer_values(graph, chosen)
    equalise(graph, find_widths(graph, set(roots(graph, values).values()), images))
    # what was moved has a range too, for where the layers that it comes from stay in float
    return Prepared(graph, found, find_ranges(graph, values.keys() - clipped(graph, values).keys(), images))

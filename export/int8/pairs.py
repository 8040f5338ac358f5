"""The integer graph: Quantize and Dequantize pairs around what ONNX Runtime then computes in eight bits."""

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from export.graph.convolutions import bias_of, kernel_of
from export.graph.graph import Graph, Node
from export.graph.operations import traits
from export.int8.integer_forms import expand_soft_pool
from export.int8.integers import LARGEST, Params, clipped, integer_values, kernel_integers, parameters
from export.int8.shifts import shift_of


def quantised(
    graph: Graph, convolutions: Collection[str], ranges: Mapping[str, tuple[float, float]], largest: int = LARGEST
) -> Graph:
    """The graph with those `convolutions` (names of their outputs) and what lies between them in integers.

    largest: of a kernel's integers; above LARGEST only to be computed in float, for comparison.
    """
    values = integer_values(graph, convolutions)
    return _Writer(graph, values, parameters(graph, values, ranges), largest).write()


class _Writer:
    """Copies a graph, node by node, with integers where there should be."""

    def __init__(self, graph: Graph, values: Mapping[str, bool], params: Mapping[str, Params], largest: int) -> None:
        self.old, self.values, self.params, self.largest = graph, values, params, largest
        self.clipped = clipped(graph, values)
        self.new = graph.without_nodes()
        self.real: dict[str, str] = {}  # the dequantised value, by the name in the old graph
        self.integers: dict[str, str] = {}

    def write(self) -> Graph:
        skip: set[str] = set()
        for node in self.old.nodes:
            if node.output in skip:
                continue
            if node.op == "SoftPool":
                skip |= self._soft_pool(node)
            elif traits(node).moves and self.values.get(node.output):
                self._move(node)
            elif node.op == "Relu" and self.values.get(node.output):
                self._quantise(node.output, node.inputs[0])
            else:
                self._copy(node)
        for name in self.old.outputs:
            self._finish(name)
        self.new.sweep()
        return self.new

    def _finish(self, name: str) -> None:
        """Make an output of its value; where that is computed in integers, of what they are worth."""
        if self.values.get(name):
            if self.new.producer(name) is not None:
                self.new.rename(name, f"{name}.exact")
            self.new.rename(self.real[name], name)
        self.new.outputs.append(name)

    def _copy(self, node: Node) -> None:
        whole = self.values.get(node.output, False)
        if node.op == "Conv" and whole:
            inputs = [self._taken(node.inputs[0], True, node), *self._kernel(node)]
        else:
            inputs = [self._taken(name, whole, node) for name in node.inputs]
        self.new.add(node.op, inputs, self.old.shapes[node.output], output=node.output, **node.attributes)
        if node.output in self.values and node.output not in self.clipped:
            self._quantise(node.output, node.output)

    def _taken(self, name: str, whole: bool, node: Node) -> str:
        """What a node takes for `name`: dequantised integers, or the float value where that is at hand."""
        if name in self.old.weights:
            if whole and self.old.weights[name].values.ndim == 4:
                return self._constant(name, int(self.old.shapes[node.output][3]))
            return name
        return self.real[name] if name in self.real and (whole or self.values[name]) else name

    def _quantise(self, name: str, source: str) -> None:
        params = self.params[name]
        whole = self.new.add("QuantizeLinear", [source, *self._scale(params)], self.old.shapes[name])
        self._know(name, whole)

    def _know(self, name: str, whole: str) -> None:
        self.integers[name] = whole
        shape = self.new.shapes[whole]
        self.real[name] = self.new.add("DequantizeLinear", [whole, *self._scale(self.params[name])], shape)

    def _scale(self, params: Params) -> list[str]:
        scale = self.new.weight("scale", np.float32(params.scale))
        return [scale, self.new.weight("zero", np.uint8(params.zero))]

    def _move(self, node: Node) -> None:
        """Move integers as they are; what a Pad adds is the integer of zero."""
        rest = list(node.inputs[1:])
        if node.op == "Pad":
            rest[1] = self.new.weight("fill", np.uint8(self.params[node.output].zero))
        inputs = [self.integers[node.inputs[0]], *rest]
        self._know(node.output, self.new.add(node.op, inputs, self.old.shapes[node.output], **node.attributes))

    def _constant(self, name: str, width: int) -> str:
        """A constant (1, C, 1, 1), over a row of the image: ONNX Runtime is slow where it meets every pixel anew."""
        values = self.old.weights[name].folded()
        params = Params.of(float(values.min()), float(values.max()))
        whole = self.new.weight(f"{name}.integers", params.to_integers(values))
        shape = (*values.shape[:3], width)
        whole = self.new.add("Expand", [whole, self.new.integers(*shape)], shape)
        return self.new.add("DequantizeLinear", [whole, *self._scale(params)], shape)

    def _kernel(self, node: Node) -> Iterator[str]:
        """Kernel and bias of a convolution; the bias in steps of what one unit of the sum is worth."""
        integers, scale = kernel_integers(kernel_of(self.old, node), self.largest)
        step = scale * np.float32(self.params[node.inputs[0]].scale)
        bias = np.clip(np.rint(bias_of(self.old, node) / step), -(2**31), 2**31 - 1).astype(np.int32)
        for values, steps, zero in ((integers, scale, np.int8), (bias, step, np.int32)):
            names = [
                self.new.weight(f"{node.output}.integers", values),
                self.new.weight(f"{node.output}.scale", steps),
                self.new.weight(f"{node.output}.zero", np.zeros(len(steps), zero)),
            ]
            yield self.new.add("DequantizeLinear", names, values.shape, axis=0)

    def _soft_pool(self, node: Node) -> set[str]:
        """Expand SoftPool of integers, dequantised so that none is positive; with the shift behind it, if there is one.

        Returns the names of nodes that are done with it.
        """
        name = node.inputs[0]
        params, shape = self.params[name], self.old.sizes(name)
        scale = self._scale(Params(params.scale, 255))
        offset = np.full(shape[1], (255 - params.zero) * params.scale)

        def real(part: str) -> str:
            return self.new.add("DequantizeLinear", [part, *scale], self.new.shapes[part])

        after = self.old.consumers(node.output)
        shifted = after[0] if len(after) == 1 else None
        extra = None if shifted is None else shift_of(self.old, shifted)
        result = node.output
        if shifted is not None and extra is not None:
            offset, result = offset + extra, shifted.output
        pooled = expand_soft_pool(self.new, self.integers[name], shape, real, 255 * params.scale, offset)
        self.new.rename(pooled, result)
        if result in self.values:
            self._quantise(result, result)
        return {result}

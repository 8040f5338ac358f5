"""From Quantize and Dequantize pairs to ONNX Runtime's integer operations, with the channels last.

ONNX Runtime makes the same of the pairs by itself, but where it meets shuffles, slices and broadcasts it turns maps
from one layout to the other and back. Here every integer map has its channels last from the start: only the first
convolutions and the outputs are turned. The integers are the same.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from export.graph.graph import Graph, Node

DOMAIN = "com.microsoft"
ELEMENTWISE = ("Sigmoid", "LeakyRelu")
POOLS = ("GlobalAveragePool", "AveragePool")
INTEGER = ("Conv", "Add", "Mul", "Concat", *ELEMENTWISE, *POOLS)
TO_LAST, TO_FIRST = [0, 2, 3, 1], [0, 3, 1, 2]
AXES = {0: 0, 1: 3, 2: 1, 3: 2}  # of the image where the channels are last


def integer_operations(graph: Graph) -> Graph:
    """The graph of Quantize and Dequantize pairs in integer operations, channels last."""
    return _Lowering(graph).run()


class _Lowering:
    """Copies a graph node by node. A value may exist with the channels first, last, or both."""

    def __init__(self, graph: Graph) -> None:
        self.old = graph
        self.made = {node.output: node for node in graph.nodes}
        self.new = Graph(weights=dict(graph.weights), inputs=list(graph.inputs))
        self.new._count = graph._count
        self.new.shapes = {name: graph.shapes[name] for name in graph.inputs}
        self.first = {name: name for name in graph.inputs}
        self.last: dict[str, str] = {}

    def run(self) -> Graph:
        done = {node.inputs[0] for node in self.old.nodes if node.op == "QuantizeLinear" and self._is_integer(node)}
        for node in self.old.nodes:
            if node.op == "QuantizeLinear" and node.inputs[0] in done:
                self._integer(node)
            elif node.output not in done:
                self._keep(node)
        for name in self.old.outputs:
            self.new.finish(self._with_first(name), name)
        self.new.sweep()
        return self.new

    def _is_integer(self, quantize: Node) -> bool:
        """Whether all that goes into the operation before `quantize` comes out of Dequantize nodes."""
        node = self.made.get(quantize.inputs[0])
        if node is None or node.op not in INTEGER or len(self.old.consumers(node.output)) != 1:
            return False
        makers = [self.made.get(name) for name in node.inputs]
        return all(maker is not None and maker.op == "DequantizeLinear" for maker in makers)

    def _integer(self, quantize: Node) -> None:
        node = self.made[quantize.inputs[0]]
        result = list(quantize.inputs[1:])
        given = [self.made[name].inputs for name in node.inputs]  # integers, scale, zero of each
        attributes: dict[str, Any] = dict(node.attributes)
        if node.op == "Conv":
            attributes["channels_last"] = 1
            data = [self._with_last(given[0][0]), *given[0][1:], *given[1], *result, given[2][0]]
        elif node.op == "Concat":
            attributes["axis"] = AXES[node.attributes["axis"]]
            if all(self._same(part[1:], result) for part in given):  # copied in half the time
                self._add_last(quantize.output, node.op, [self._with_last(part[0]) for part in given], attributes)
                return
            data = result + [part for x, scale, zero in given for part in (self._with_last(x), scale, zero)]
        else:
            if node.op in POOLS:
                attributes["channels_last"] = 1
            data = [part for x, scale, zero in given for part in (self._with_last(x), scale, zero)] + result
        self._add_last(quantize.output, f"QLinear{node.op}", data, attributes, DOMAIN)

    def _keep(self, node: Node) -> None:
        source = node.inputs[0]
        only_last = source in self.last and source not in self.first
        if node.op == "Transpose" and node.attributes["perm"] == TO_LAST:
            self.first[node.output] = self._with_last(source)
        elif node.op == "Transpose" and node.attributes["perm"] == TO_FIRST:
            self.last[node.output] = self._with_first(source)
        elif node.op == "QuantizeLinear" and only_last:
            self._add_last(node.output, node.op, [self.last[source], *node.inputs[1:]], node.attributes)
        elif node.op in ("Slice", "Pad", "Resize", "DepthToSpace") and only_last:
            self._move(node)
        else:
            inputs = [self._with_first(name) if name else name for name in node.inputs]
            self.first[node.output] = self.new.add(node.op, inputs, self.old.shapes[node.output], **node.attributes)

    def _add_last(
        self, output: str, op: str, inputs: list[str], attributes: Mapping[str, Any], domain: str = ""
    ) -> None:
        shape = self.old.shapes[output]
        name = self.new.add(op, inputs, tuple(shape[i] for i in TO_LAST), **attributes)
        self.new.nodes[-1].domain = domain
        self.last[output] = name

    def _move(self, node: Node) -> None:
        """Slices, pads, repeats or shuffles integers with the channels last."""
        x, rest = self.last[node.inputs[0]], [self.old.weights[n].values if n else None for n in node.inputs[1:]]
        if node.op in ("DepthToSpace", "Resize"):
            self.last[node.output] = self._shuffled(node, x) if node.op == "DepthToSpace" else self._enlarged(node, x)
            return
        if node.op == "Slice":
            rest[2] = np.asarray([AXES[int(axis)] for axis in rest[2]], np.int64)
        else:
            rest[0] = rest[0].reshape(2, 4)[:, TO_LAST].reshape(-1)
        names = ["" if values is None else self._setting(values) for values in rest]
        self._add_last(node.output, node.op, [x, *names], node.attributes)

    def _same(self, a: Sequence[str], b: Sequence[str]) -> bool:
        return all(np.array_equal(*(self.old.weights[name].values for name in pair)) for pair in zip(a, b, strict=True))

    def _setting(self, values: np.ndarray) -> str:
        return self.new.number("setting", values[()]) if values.ndim == 0 else self.new.weight("setting", values)

    def _enlarged(self, node: Node, x: str) -> str:
        """Nearest neighbours: whole pixels, then whole rows are copied, in a fifth of the time of a Resize."""
        shape = list(self.new.shapes[x])
        factors = self.old.weights[node.inputs[2]].values[TO_LAST].astype(int)
        for axis in (2, 1):
            places = self.new.weight("places", np.arange(shape[axis], dtype=np.int32).repeat(factors[axis]))
            shape[axis] *= factors[axis]
            x = self.new.add("Gather", [x, places], tuple(map(int, shape)), axis=axis)
        return x

    def _shuffled(self, node: Node, x: str) -> str:
        """Pixel shuffle. In mode DCR runs of c channels move; in mode CRD single ones do."""
        _, height, width, channels = map(int, self.new.shapes[x])
        size = node.attributes["blocksize"]
        c = channels // size**2
        lie = (size, size, c) if node.attributes["mode"] == "DCR" else (c, size, size)
        order = [0, 1, 3, 2, 4, 5] if node.attributes["mode"] == "DCR" else [0, 1, 4, 2, 5, 3]
        split = self._reshaped(x, (1, height, width, *lie))
        moved = self.new.add("Transpose", [split], (1, height, size, width, size, c), perm=order)
        return self._reshaped(moved, (1, height * size, width * size, c))

    def _reshaped(self, x: str, shape: tuple[int, ...]) -> str:
        return self.new.add("Reshape", [x, self.new.weight("integers", np.asarray(shape, np.int64))], shape)

    def _with_first(self, name: str) -> str:
        """The value with the channels first (or of another rank); a weight as it is."""
        if name in self.old.weights:
            return name
        if name not in self.first:
            shape = self.old.shapes[name]
            self.first[name] = self.new.add("Transpose", [self.last[name]], shape, perm=TO_FIRST)
        return self.first[name]

    def _with_last(self, name: str) -> str:
        if name in self.old.weights:
            values = self.old.weights[name].values
            return self.new.weight(f"{name}.last", values.transpose(TO_LAST)) if values.ndim == 4 else name
        if name not in self.last:
            shape = tuple(self.old.shapes[name][i] for i in TO_LAST)
            self.last[name] = self.new.add("Transpose", [self.first[name]], shape, perm=TO_LAST)
        return self.last[name]

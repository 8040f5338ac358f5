"""From Quantize and Dequantize pairs to ONNX Runtime's integer operations, with the channels last.

ONNX Runtime makes the same of the pairs by itself, but where it meets shuffles, slices and broadcasts it turns maps
from one layout to the other and back. Here every integer map has its channels last from the start: only the first
convolutions and the outputs are turned. The integers are the same.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from export.graph.graph import Graph, Node
from export.graph.operations import traits

DOMAIN = "com.microsoft"
TO_LAST, TO_FIRST = [0, 2, 3, 1], [0, 3, 1, 2]
AXES = {0: 0, 1: 3, 2: 1, 3: 2}  # of the image where the channels are last


def integer_operations(graph: Graph) -> Graph:
    """The graph of Quantize and Dequantize pairs in integer operations, channels last."""
    return _Lowering(graph).run()


class _Lowering:
    """Copies a graph node by node. A value may exist with the channels first, last, or both."""

    def __init__(self, graph: Graph) -> None:
        self.old, self.new = graph, graph.without_nodes()
        self.first = {name: name for name in graph.inputs}
        self.last: dict[str, str] = {}
        self.moves = {
            "Slice": self._sliced,
            "Pad": self._padded,
            "Resize": self._enlarged,
            "DepthToSpace": self._shuffled,
        }

    def run(self) -> Graph:
        done = {node.inputs[0] for node in self.old.nodes if self._integer_before(node) is not None}
        for node in self.old.nodes:
            if (before := self._integer_before(node)) is not None:
                self._integer(before, node)
            elif node.output not in done:
                self._keep(node)
        for name in self.old.outputs:
            self.new.finish(self._with_first(name), name)
        self.new.sweep()
        return self.new

    def _integer_before(self, quantize: Node) -> Node | None:
        """The operation before a Quantize node if all that goes into it comes out of Dequantize nodes."""
        node = self.old.producer(quantize.inputs[0]) if quantize.op == "QuantizeLinear" else None
        if node is None or not traits(node).integer or len(self.old.consumers(node.output)) != 1:
            return None
        makers = [self.old.producer(name) for name in node.inputs]
        return node if all(maker is not None and maker.op == "DequantizeLinear" for maker in makers) else None

    def _integer(self, node: Node, quantize: Node) -> None:
        """Write an operation between pairs as the one that takes and gives integers."""
        result = list(quantize.inputs[1:])
        makers = [self.old.producer(name) for name in node.inputs]
        given = [maker.inputs for maker in makers if maker is not None]  # integers, scale, zero of each
        attributes = dict(node.attributes)
        if traits(node).told_layout:
            attributes["channels_last"] = 1
        if node.op == "Conv":
            data = [self._with_last(given[0][0]), *given[0][1:], *given[1], *result, given[2][0]]
        elif node.op == "Concat":
            attributes["axis"] = AXES[node.attributes["axis"]]
            if all(self._same(part[1:], result) for part in given):  # copied in half the time
                self._add_last(quantize.output, node.op, [self._with_last(part[0]) for part in given], attributes)
                return
            data = result + self._parts(given)
        else:
            data = self._parts(given) + result
        self._add_last(quantize.output, f"QLinear{node.op}", data, attributes, DOMAIN)

    def _parts(self, given: Sequence[Sequence[str]]) -> list[str]:
        """Integers with the channels last, scale and zero of each, in a row."""
        return [name for x, scale, zero in given for name in (self._with_last(x), scale, zero)]

    def _keep(self, node: Node) -> None:
        source = node.inputs[0]
        only_last = source in self.last and source not in self.first
        if node.op == "Transpose" and node.attributes["perm"] == TO_LAST:
            self.first[node.output] = self._with_last(source)
        elif node.op == "Transpose" and node.attributes["perm"] == TO_FIRST:
            self.last[node.output] = self._with_first(source)
        elif node.op == "QuantizeLinear" and only_last:
            self._add_last(node.output, node.op, [self.last[source], *node.inputs[1:]], node.attributes)
        elif node.op in self.moves and only_last:
            self.moves[node.op](node, self.last[source])
        else:
            inputs = [self._with_first(name) if name else name for name in node.inputs]
            self.first[node.output] = self.new.add(node.op, inputs, self.old.shapes[node.output], **node.attributes)

    def _add_last(
        self, output: str, op: str, inputs: Sequence[str], attributes: Mapping[str, Any], domain: str = ""
    ) -> None:
        shape = self.old.shapes[output]
        self.last[output] = self.new.add(op, inputs, tuple(shape[i] for i in TO_LAST), domain=domain, **attributes)

    def _same(self, a: Sequence[str], b: Sequence[str]) -> bool:
        """Whether two lists of constants hold the same numbers."""
        values = self.old.weights
        return all(np.array_equal(values[x].values, values[y].values) for x, y in zip(a, b, strict=True))

    def _sliced(self, node: Node, x: str) -> None:
        starts, ends, axes, *steps = (self.old.weights[name].values for name in node.inputs[1:])
        values = [starts, ends, np.asarray([AXES[int(axis)] for axis in axes], np.int64), *steps]
        self._add_last(node.output, node.op, [x, *(self.new.weight("setting", v) for v in values)], node.attributes)

    def _padded(self, node: Node, x: str) -> None:
        pads, fill = (self.old.weights[name].values for name in node.inputs[1:])
        values = [pads.reshape(2, 4)[:, TO_LAST].reshape(-1), fill]
        self._add_last(node.output, node.op, [x, *(self.new.weight("setting", v) for v in values)], node.attributes)

    def _enlarged(self, node: Node, x: str) -> None:
        """Nearest neighbours: whole pixels, then whole rows are copied, in a fifth of the time of a Resize."""
        shape = list(self.new.sizes(x))
        factors = self.old.weights[node.inputs[2]].values[TO_LAST].astype(int).tolist()
        for axis in (2, 1):
            shape[axis] *= factors[axis]
            places = self._each_repeated(shape[axis], factors[axis])
            x = self.new.add("Gather", [x, places], tuple(shape), axis=axis)
        self.last[node.output] = x

    def _each_repeated(self, count: int, times: int) -> str:
        """0, 0, 1, 1, 2, ... (count,) int64: each number so many times."""
        zero, one, factor = (self.new.weight("number", np.int64(value)) for value in (0, 1, times))
        end = self.new.add("Squeeze", [self.new.integers(count)], ())
        every = self.new.add("Range", [zero, end, one], (count,))
        return self.new.add("Div", [every, factor], (count,))

    def _shuffled(self, node: Node, x: str) -> None:
        """Pixel shuffle. In mode DCR runs of c channels move; in mode CRD single ones do."""
        _, height, width, channels = self.new.sizes(x)
        size = node.attributes["blocksize"]
        c = channels // size**2
        lie = (size, size, c) if node.attributes["mode"] == "DCR" else (c, size, size)
        order = [0, 1, 3, 2, 4, 5] if node.attributes["mode"] == "DCR" else [0, 1, 4, 2, 5, 3]
        split = self.new.reshape(x, (1, height, width, *lie))
        moved = self.new.add("Transpose", [split], (1, height, size, width, size, c), perm=order)
        self.last[node.output] = self.new.reshape(moved, (1, height * size, width * size, c))

    def _with_first(self, name: str) -> str:
        """The value with the channels first (or of another rank); a weight as it is."""
        if name in self.old.weights:
            return name
        if name not in self.first:
            shape = self.old.shapes[name]
            self.first[name] = self.new.add("Transpose", [self.last[name]], shape, perm=TO_FIRST)
        return self.first[name]

    def _with_last(self, name: str) -> str:
        """The value (or weight) with the channels last; what has not four dimensions as it is."""
        if name in self.old.weights:
            values = self.old.weights[name].values
            return self.new.weight(f"{name}.last", values.transpose(TO_LAST)) if values.ndim == 4 else name
        if name not in self.last:
            shape = tuple(self.old.shapes[name][i] for i in TO_LAST)
            self.last[name] = self.new.add("Transpose", [self.first[name]], shape, perm=TO_LAST)
        return self.last[name]

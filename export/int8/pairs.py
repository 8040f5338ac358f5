"""The integer graph: Quantize and Dequantize pairs around what ONNX Runtime then computes in eight bits.

Activations are uint8 with a scale and a zero point of the whole map; kernels int8 with a scale for every output
channel, of 7 bits: |u8 * s7 + u8 * s7| <= 2 * 255 * 64 = 32,640 fits the 16-bit sums of processors without VNNI.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from export.graph.graph import Graph, Node
from export.graph.rewrite import bias_of, is_plain
from export.int8.integer_forms import expand_soft_pool
from export.int8.shifts import shift_of

LARGEST = 64  # of a kernel's integers
LARGEST_SHARE = 4  # times as wide may a range be that a part of a concatenation shares: it keeps 6 of its 8 bits
BINARY = ("Add", "Mul", "Concat")  # in integers where one of their inputs is
UNARY = ("Relu", "LeakyRelu", "Sigmoid", "GlobalAveragePool")  # in integers where their input is
MOVING = ("Slice", "Pad", "DepthToSpace", "Resize", "Reshape", "Transpose")  # integers move as they are
RAW = ("Slice", "Clip", "Reshape", "Transpose")  # leave the raw input raw


@dataclass(frozen=True)
class Params:
    """real = (integer - zero) * scale."""

    scale: float
    zero: int

    @classmethod
    def of(cls, low: float, high: float) -> "Params":
        """uint8 for values in low..high; zero is met exactly."""
        low, high = min(low, 0.0), max(high, 0.0)
        scale = float(np.float32(max(high - low, 1e-6) / 255))
        return cls(scale, round(-low / scale))

    def to_integers(self, values: np.ndarray) -> np.ndarray:
        """Nearest integers, clipped."""
        return np.clip(np.rint(values / self.scale) + self.zero, 0, 255).astype(np.uint8)


def kernel_integers(kernel: np.ndarray, largest: int = LARGEST) -> tuple[np.ndarray, np.ndarray]:
    """Integers -largest..largest (O, I, kh, kw) int8, and the scale (O,) f32 of every output channel."""
    peak = np.abs(kernel).reshape(len(kernel), -1).max(1)
    scale = np.float32(np.maximum(peak, 1e-8) / largest)
    return np.clip(np.rint(kernel / scale[:, None, None, None]), -largest, largest).astype(np.int8), scale


def last_convolutions(graph: Graph) -> set[str]:
    """Outputs of the convolutions behind which no other leads to a result, features aside: they make the logits."""
    final, last = set(graph.outputs) - {"features"}, set()
    for node in reversed(graph.nodes):
        if node.output in final and node.op == "Conv":
            last.add(node.output)
        elif node.output in final:
            final.update(node.inputs)
    return last


def layers(graph: Graph) -> list[str]:
    """Convolutions that may compute in integers, by the name of their output: neither first, last nor of one pixel."""
    raw = set(graph.inputs)
    for node in graph.nodes:
        if node.op in RAW and node.inputs[0] in raw:
            raw.add(node.output)
    last = last_convolutions(graph)
    return [
        node.output
        for node in graph.nodes
        if is_plain(node)
        and node.inputs[0] not in raw
        and node.output not in last
        and graph.shapes[node.output][2:] != (1, 1)
    ]


def integer_values(graph: Graph, convolutions: Collection[str]) -> dict[str, bool]:
    """Values that exist as integers: computed so (True), or quantised because something in integers takes them."""
    found: dict[str, bool] = {}
    for node in graph.nodes:
        given = [name for name in node.inputs if name and name not in graph.weights]
        known = [name for name in given if found.get(name)]
        if node.op == "Conv":
            chosen = node.output in convolutions
        elif node.op == "Relu":
            chosen = bool(known) and len(graph.consumers(given[0])) == 1 and _clips(graph, given[0])
        else:
            chosen = bool(known) and node.op in (*BINARY, *UNARY, *MOVING)
        if chosen:
            found[node.output] = True
            for name in given:
                found.setdefault(name, False)
        elif node.op == "SoftPool":
            found.setdefault(given[0], False)
    for node in reversed(graph.nodes):  # what only float operations take is cheaper in float
        late = shift_of(graph, node) is not None or node.op == "Resize"
        if found.get(node.output) and late and not any(found.get(t.output) for t in graph.consumers(node.output)):
            del found[node.output]
    return found


def _clips(graph: Graph, name: str) -> bool:
    """Whether the integers of a ReLU behind `name` come from an operation that clips them itself."""
    producer = graph.producer(name)
    return producer is not None and producer.op in ("Conv", "Add")


def roots(graph: Graph, values: Mapping[str, bool]) -> dict[str, str]:
    """The value whose integers each value has: its own, what was moved to make it, or the ReLU that clips it."""
    found: dict[str, str] = {}
    for name in values:
        origin = name
        while (node := graph.producer(origin)) is not None and node.op in MOVING and values.get(origin):
            origin = node.inputs[0]
        found[name] = origin
    return found | clipped(graph, values)


def clipped(graph: Graph, values: Mapping[str, bool]) -> dict[str, str]:
    """Results that a ReLU clips, and what it makes of them: their integers end at its zero point, 0."""
    return {node.inputs[0]: node.output for node in graph.nodes if node.op == "Relu" and values.get(node.output)}


def parameters(
    graph: Graph, values: Mapping[str, bool], ranges: Mapping[str, tuple[float, float]]
) -> dict[str, Params]:
    """Scale and zero point of every value; parts of a concatenation share them unless one were left with few steps.

    Nor where a ReLU's integers are clipped at a zero point of 0 and another part reaches below zero.
    """
    origin, rectified = roots(graph, values), set(clipped(graph, values).values())
    own = {name: ranges[origin[name]] for name in values}
    for node in graph.nodes:
        if node.op == "Concat" and values.get(node.output):
            names = {node.output, *(origin[name] for name in node.inputs)}
            low, high = min(own[name][0] for name in names), max(own[name][1] for name in names)
            possible = low == 0 or not names & rectified
            if possible and all(high - low <= LARGEST_SHARE * (own[name][1] - own[name][0]) for name in names):
                own.update(dict.fromkeys(names, (low, high)))
    return {name: Params.of(*own[origin[name]]) for name in values}


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
        self.new = Graph(
            weights=dict(graph.weights), shapes=dict(graph.shapes), inputs=list(graph.inputs), _count=graph._count
        )
        self.real: dict[str, str] = {}  # the dequantised value, by the name in the old graph
        self.integers: dict[str, str] = {}

    def write(self) -> Graph:
        skip: set[str] = set()
        for node in self.old.nodes:
            if node.output in skip:
                continue
            if node.op == "SoftPool":
                skip |= self._soft_pool(node)
            elif node.op in MOVING and self.values.get(node.output):
                self._move(node)
            elif node.op == "Relu" and self.values.get(node.output):
                self._quantise(node.output, node.inputs[0])
            else:
                self._copy(node)
        self.new.outputs = list(self.old.outputs)
        for name in self.old.outputs:
            self._keep_name(name)
        self.new.sweep()
        return self.new

    def _keep_name(self, output: str) -> None:
        """Let an output that is computed in integers be the dequantised value under its old name."""
        if not self.values.get(output):
            return
        for node in self.new.nodes:
            if node.output == output:
                node.output = f"{output}.exact"
            node.inputs = [f"{output}.exact" if name == output else name for name in node.inputs]
        shown = self.new.producer(self.real[output])
        assert shown is not None
        self.new.replace(shown.output, output)
        shown.output = output

    def _copy(self, node: Node) -> None:
        whole = self.values.get(node.output, False)
        if node.op == "Conv" and whole:
            inputs = [self._taken(node.inputs[0], True, node), *self._kernel(node)]
        else:
            inputs = [self._taken(name, whole, node) for name in node.inputs]
        self.new.nodes.append(Node(node.op, inputs, node.output, node.attributes))
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
        scale = self.new.number("scale", np.float32(params.scale))
        return [scale, self.new.number("zero", np.uint8(params.zero))]

    def _move(self, node: Node) -> None:
        """Move integers as they are; what a Pad adds is the integer of zero."""
        rest = list(node.inputs[1:])
        if node.op == "Pad":
            rest[1] = self.new.number("fill", np.uint8(self.params[node.output].zero))
        inputs = [self.integers[node.inputs[0]], *rest]
        self._know(node.output, self.new.add(node.op, inputs, self.old.shapes[node.output], **node.attributes))

    def _constant(self, name: str, width: int) -> str:
        """A constant (1, C, 1, 1), over a row of the image: ONNX Runtime is slow where it meets every pixel anew."""
        values = self.old.weights[name].folded()
        params = Params.of(float(values.min()), float(values.max()))
        whole = self.new.weight(f"{name}.integers", params.to_integers(values))
        shape = (*values.shape[:3], width)
        size = self.new.weight("integers", np.asarray(shape, np.int64))
        whole = self.new.add("Expand", [whole, size], shape)
        return self.new.add("DequantizeLinear", [whole, *self._scale(params)], shape)

    def _kernel(self, node: Node) -> Iterator[str]:
        """Kernel and bias of a convolution; the bias in steps of what one unit of the sum is worth."""
        integers, scale = kernel_integers(self.old.weights[node.inputs[1]].folded(), self.largest)
        step = np.float32(scale * self.params[node.inputs[0]].scale)
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
        params = self.params[name]
        shape = self.old.shapes[name]
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
        last = self.new.producer(pooled)
        assert last is not None
        last.output = result
        if result in self.values:
            self._quantise(result, result)
        return {result}

"""What becomes integers: which convolutions and values, and the scales of all of them.

Activations are uint8 with a scale and a zero point of the whole map; kernels int8 with a scale for every output
channel, of 7 bits: |u8 * s7 + u8 * s7| <= 2 * 255 * 64 = 32,640 fits the 16-bit sums of processors without VNNI.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from export.graph.convolutions import is_plain
from export.graph.graph import Graph
from export.graph.operations import traits
from export.int8.shifts import shift_of

LARGEST = 64  # of a kernel's integers
LARGEST_SHARE = 4  # times as wide may a range be that a part of a concatenation shares: it keeps 6 of its 8 bits


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
        integers: np.ndarray = np.clip(np.rint(values / self.scale) + self.zero, 0, 255).astype(np.uint8)
        return integers


def kernel_integers(kernel: np.ndarray, largest: int = LARGEST) -> tuple[np.ndarray, np.ndarray]:
    """Integers -largest..largest (O, I, kh, kw) int8, and the scale (O,) f32 of every output channel."""
    peak = np.abs(kernel).reshape(len(kernel), -1).max(1)
    scale: np.ndarray = (np.maximum(peak, 1e-8) / largest).astype(np.float32)
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
        if (traits(node).moves or traits(node).elementwise) and node.inputs[0] in raw:
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
            chosen = bool(known) and (traits(node).integer or traits(node).moves)
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
    return producer is not None and traits(producer).clips


def roots(graph: Graph, values: Mapping[str, bool]) -> dict[str, str]:
    """The value whose integers each value has: its own, what was moved to make it, or the ReLU that clips it."""
    found: dict[str, str] = {}
    for name in values:
        origin = name
        while (node := graph.producer(origin)) is not None and traits(node).moves and values.get(origin):
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

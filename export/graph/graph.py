"""A graph of operations for the rewrites to change; who makes a value and who takes it is looked up in an index."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from onnx import TensorProto

Shape = tuple[int | str, ...]  # a dimension is a number, or the name of one that changes from run to run


@dataclass(frozen=True)
class Weight:
    """A constant: `values` as the checkpoint has them, times `scale` that is folded into them (broadcast)."""

    values: np.ndarray
    scale: np.ndarray | None = None

    def folded(self) -> np.ndarray:
        """The array that the network computes with."""
        if self.scale is None:
            return self.values
        return np.asarray(self.values * self.scale, np.float32)


@dataclass(eq=False)
class Node:
    """One operation with one output; `op` and `attributes` are those of ONNX, `domain` is "" but for extensions.

    Only its graph changes inputs and output, for it keeps the index of them.
    """

    op: str
    inputs: tuple[str, ...]  # names; "" stands for one that is left out
    output: str
    attributes: dict[str, Any] = field(default_factory=dict)
    domain: str = ""


class Graph:
    """Nodes in the order of computation; every value has a name and, but for weights, a shape."""

    def __init__(self) -> None:
        self.weights: dict[str, Weight] = {}
        self.shapes: dict[str, Shape] = {}
        self.inputs: dict[str, int] = {}  # element type, a TensorProto.DataType, by name
        self.outputs: list[str] = []
        self._nodes: list[Node] = []
        self._producers: dict[str, Node] = {}
        self._consumers: dict[str, dict[Node, None]] = {}  # in the order in which they came
        self._place: Node | None = None  # new nodes stand in front of it; None: at the end
        self._count = 0

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes as they are now: the graph may change while one goes through them."""
        return tuple(self._nodes)

    def producer(self, name: str) -> Node | None:
        """The node whose output is `name`; None for weights and inputs of the graph."""
        return self._producers.get(name)

    def consumers(self, name: str) -> tuple[Node, ...]:
        """The nodes that take `name`."""
        return tuple(self._consumers.get(name, ()))

    def only_consumer(self, name: str) -> Node | None:
        """The one node that takes `name`; None where there are others, or `name` is an output."""
        consumers = self.consumers(name)
        return consumers[0] if len(consumers) == 1 and name not in self.outputs else None

    def sizes(self, name: str) -> tuple[int, ...]:
        """The shape of a value all of whose dimensions are numbers."""
        return tuple(int(size) for size in self.shapes[name])

    def channels(self, name: str) -> int:
        """Channels of a map (1, C, H, W)."""
        return int(self.shapes[name][1])

    def input(self, name: str, shape: Shape, kind: int = TensorProto.FLOAT) -> str:
        """Declare an input of the graph and return its name."""
        self.inputs[name], self.shapes[name] = kind, shape
        return name

    def weight(self, name: str, values: np.ndarray | np.generic, scale: np.ndarray | None = None) -> str:
        """Store a constant, float64 as float32, and return its name: `name`, numbered where that is taken."""
        if name in self.weights:
            self._count += 1
            name = f"{name}_{self._count}"
        kind = np.float32 if values.dtype == np.float64 else values.dtype
        self.weights[name] = Weight(np.asarray(values, kind, order="C"), scale)
        return name

    def integers(self, *values: int) -> str:
        """Store whole numbers (n,) int64, as shapes and axes are, and return their name."""
        return self.weight("integers", np.asarray(values, np.int64))

    def add(
        self, op: str, inputs: Sequence[str], shape: Shape, *, output: str = "", domain: str = "", **attributes: Any
    ) -> str:
        """Add a node, at the end or where `before` says, and return the name of its output, a new one if none is given.

        shape: of the output.
        """
        if not output:
            self._count += 1
            output = f"{op.lower()}_{self._count}"
        self.shapes[output] = shape
        self._insert(Node(op, tuple(inputs), output, attributes, domain))
        return output

    def reshape(self, x: str, shape: tuple[int, ...]) -> str:
        """Add a Reshape of `x`."""
        return self.add("Reshape", [x, self.integers(*shape)], shape)

    def slice(self, x: str, shape: Shape, axis: int, start: int, end: int, step: int = 1) -> str:
        """Add a Slice of `x` that leaves `shape`."""
        return self.add("Slice", [x, *(self.integers(value) for value in (start, end, axis, step))], shape)

    @contextmanager
    def before(self, node: Node) -> Iterator[None]:
        """Nodes that are added meanwhile stand in front of `node`."""
        kept, self._place = self._place, node
        try:
            yield
        finally:
            self._place = kept

    def rewire(self, node: Node, inputs: Sequence[str]) -> None:
        """Let `node` take other inputs."""
        self._forget(node)
        node.inputs = tuple(inputs)
        self._index(node)

    def replace(self, old: str, new: str) -> None:
        """Let everything that takes `old` take `new`."""
        for node in self.consumers(old):
            self.rewire(node, [new if name == old else name for name in node.inputs])
        self.outputs = [new if name == old else name for name in self.outputs]

    def rename(self, old: str, new: str) -> None:
        """Give the output of a node another name."""
        node = self._producers.pop(old)
        node.output, self._producers[new] = new, node
        self.shapes[new] = self.shapes.pop(old)
        self.replace(old, new)

    def supplant(self, node: Node, value: str) -> None:
        """Drop `node`; `value` takes the name of its output, and with it its place."""
        self._forget(node)
        self._nodes.remove(node)
        self.rename(value, node.output)

    def finish(self, value: str, name: str) -> None:
        """Make `value` the output `name`."""
        self.rename(value, name)
        self.outputs.append(name)

    def sweep(self) -> None:
        """Drop nodes and weights that no output needs."""
        needed, kept = set(self.outputs), []
        for node in reversed(self._nodes):
            if node.output in needed:
                kept.append(node)
                needed.update(node.inputs)
            else:
                self._forget(node)
        self._nodes = kept[::-1]
        self.weights = {name: weight for name, weight in self.weights.items() if name in needed}

    def copy(self) -> "Graph":
        """The same graph, to be changed by itself."""
        other = self.without_nodes()
        for node in self._nodes:
            other._insert(replace(node))
        other.outputs = list(self.outputs)
        return other

    def without_nodes(self) -> "Graph":
        """Its inputs, weights and shapes, to write other nodes between; no new name is one of this graph."""
        other = Graph()
        other.weights, other.shapes, other.inputs = dict(self.weights), dict(self.shapes), dict(self.inputs)
        other._count = self._count
        return other

    def _insert(self, node: Node) -> None:
        at = len(self._nodes) if self._place is None else self._nodes.index(self._place)
        self._nodes.insert(at, node)
        self._index(node)

    def _index(self, node: Node) -> None:
        self._producers[node.output] = node
        for name in node.inputs:
            self._consumers.setdefault(name, {})[node] = None

    def _forget(self, node: Node) -> None:
        del self._producers[node.output]
        for name in node.inputs:
            self._consumers[name].pop(node, None)

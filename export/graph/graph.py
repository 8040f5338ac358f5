"""A small graph of operations, and its form as an ONNX model."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 17
IR_VERSION = 8  # of the ONNX file, that of opset 17


@dataclass
class Weight:
    """A constant: `values` as the checkpoint has them, times `scale` that is folded into them (broadcast)."""

    values: np.ndarray
    scale: np.ndarray | None = None

    def folded(self) -> np.ndarray:
        """The array that the network computes with."""
        if self.scale is None:
            return self.values
        return (self.values * self.scale).astype(np.float32)


@dataclass
class Node:
    """One operation with one output; `op` and `attributes` are those of ONNX, `domain` is "" but for extensions."""

    op: str
    inputs: list[str]
    output: str
    attributes: dict[str, Any] = field(default_factory=dict)
    domain: str = ""


@dataclass
class Graph:
    """Nodes in the order of computation; every value has a name and, but for weights, a shape.

    A dimension is a number, or the name of one that changes from run to run.
    """

    nodes: list[Node] = field(default_factory=list)
    weights: dict[str, Weight] = field(default_factory=dict)
    shapes: dict[str, tuple[int | str, ...]] = field(default_factory=dict)
    kinds: dict[str, int] = field(default_factory=dict)  # element types of inputs other than float32
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    _count: int = 0

    def add(self, op: str, inputs: list[str], shape: tuple[int | str, ...], **attributes: Any) -> str:
        """Append a node and return the name of its output."""
        output = self.new_name(op, shape)
        self.nodes.append(Node(op, inputs, output, attributes))
        return output

    def new_name(self, op: str, shape: tuple[int | str, ...]) -> str:
        """An unused name, for a value of `shape`."""
        self._count += 1
        name = f"{op.lower()}_{self._count}"
        self.shapes[name] = shape
        return name

    def weight(self, name: str, values: np.ndarray, scale: np.ndarray | None = None) -> str:
        """Store a constant and return its name."""
        if name in self.weights:
            self._count += 1
            name = f"{name}_{self._count}"
        self.weights[name] = Weight(np.ascontiguousarray(values), scale)
        return name

    def number(self, name: str, value: np.generic) -> str:
        """Store a constant without dimensions and return its name; `weight` gives every constant at least one."""
        name = self.weight(name, np.asarray(value))
        self.weights[name].values = np.asarray(value)
        return name

    def producer(self, name: str) -> Node | None:
        """The node whose output is `name`; None for weights and inputs of the graph."""
        return next((node for node in self.nodes if node.output == name), None)

    def consumers(self, name: str) -> list[Node]:
        """The nodes that take `name`."""
        return [node for node in self.nodes if name in node.inputs]

    def replace(self, old: str, new: str) -> None:
        """Let everything that takes `old` take `new`."""
        for node in self.nodes:
            node.inputs = [new if name == old else name for name in node.inputs]
        self.outputs = [new if name == old else name for name in self.outputs]

    def finish(self, value: str, name: str) -> None:
        """Make `value` the output `name`."""
        for node in self.nodes:
            node.output = name if node.output == value else node.output
        self.shapes[name] = self.shapes.pop(value)
        self.replace(value, name)
        self.outputs.append(name)

    def sweep(self) -> None:
        """Drop nodes and weights that no output needs."""
        needed, kept = set(self.outputs), []
        for node in reversed(self.nodes):
            if node.output in needed:
                kept.append(node)
                needed.update(node.inputs)
        self.nodes = kept[::-1]
        self.weights = {name: weight for name, weight in self.weights.items() if name in needed}


def to_model(graph: Graph, name: str = "image_net") -> onnx.ModelProto:
    """The ONNX model of `graph`, called `name`; the same bytes for the same graph.

    Kernels that float16 holds without loss are stored so, each followed by the Cast (and the scale folded into it) that
    a runtime computes once, when it loads the model; all arithmetic is float32.
    """
    nodes: list[onnx.NodeProto] = []
    initialisers: list[TensorProto] = []
    for key, weight in graph.weights.items():
        half = _as_half(weight.values)
        if half is not None:
            initialisers.append(numpy_helper.from_array(half, f"{key}.half"))
            scaled = weight.scale is not None
            cast = f"{key}.cast" if scaled else key
            nodes.append(helper.make_node("Cast", [f"{key}.half"], [cast], cast, to=TensorProto.FLOAT))
            if weight.scale is not None:
                scale = weight.scale.astype(np.float32)
                initialisers.append(numpy_helper.from_array(scale, f"{key}.scale"))
                nodes.append(helper.make_node("Mul", [cast, f"{key}.scale"], [key], key))
        else:
            initialisers.append(numpy_helper.from_array(weight.folded(), key))
    for node in graph.nodes:
        attributes = dict(sorted(node.attributes.items()))
        nodes.append(
            helper.make_node(node.op, node.inputs, [node.output], node.output, domain=node.domain or None, **attributes)
        )
    domains = sorted({node.domain for node in graph.nodes} - {""})
    model = helper.make_model(
        helper.make_graph(
            nodes,
            name,
            list(_values(graph, graph.inputs)),
            list(_values(graph, graph.outputs)),
            initialisers,
        ),
        producer_name="lidar-mos",
        opset_imports=[helper.make_opsetid("", OPSET), *(helper.make_opsetid(domain, 1) for domain in domains)],
        ir_version=IR_VERSION,
    )
    onnx.checker.check_model(model, full_check=True)
    return model


def _as_half(values: np.ndarray) -> np.ndarray | None:
    """`values` as float16 if they are so already, or the kernel of a convolution that loses nothing."""
    if values.dtype == np.float16:
        return values
    if values.ndim < 4 or values.dtype != np.float32:
        return None
    with np.errstate(over="ignore"):
        half = values.astype(np.float16)
    return half if np.array_equal(half, values) else None


def _values(graph: Graph, names: list[str]) -> Iterator[onnx.ValueInfoProto]:
    for name in names:
        yield helper.make_tensor_value_info(name, graph.kinds.get(name, TensorProto.FLOAT), graph.shapes[name])

"""The ONNX file of a graph."""

from collections.abc import Iterator

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from export.graph.any_size import follow_size, named
from export.graph.graph import Graph

OPSET = 17
IR_VERSION = 8  # of the ONNX file, that of opset 17


def onnx_bytes(graph: Graph, name: str = "image_net") -> bytes:
    """The ONNX model of `graph`, called `name`; the same bytes for the same graph.

    Kernels that float16 holds without loss are stored so, each followed by the Cast (and the scale folded into it) that
    a runtime computes once, when it loads the model; all arithmetic is float32. A graph that was traced at `any_size`
    takes images of any size.
    """
    graph = follow_size(graph)
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
    outputs = dict.fromkeys(graph.outputs, int(TensorProto.FLOAT))
    model = helper.make_model(
        helper.make_graph(nodes, name, list(_values(graph, graph.inputs)), list(_values(graph, outputs)), initialisers),
        producer_name="lidar-mos",
        opset_imports=[helper.make_opsetid("", OPSET), *(helper.make_opsetid(domain, 1) for domain in domains)],
        ir_version=IR_VERSION,
    )
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def _as_half(values: np.ndarray) -> np.ndarray | None:
    """`values` as float16 if they are so already, or the kernel of a convolution that loses nothing."""
    if values.dtype == np.float16:
        return values
    if values.ndim < 4 or values.dtype != np.float32:
        return None
    with np.errstate(over="ignore"):
        half = values.astype(np.float16)
    return half if np.array_equal(half, values) else None


def _values(graph: Graph, kinds: dict[str, int]) -> Iterator[onnx.ValueInfoProto]:
    for name, kind in kinds.items():
        yield helper.make_tensor_value_info(name, kind, named(graph.shapes[name]))

"""What the values inside a network are on the calibration scans: what LeakyReLUs take, and ranges."""

from collections.abc import Collection, Sequence

import numpy as np

from export.graph.graph import Graph
from export.graph.serialise import onnx_bytes
from export.int8.integer_forms import expand_soft_pool
from export.int8.shifts import Halves, leaky_convolutions
from runtime.compute.sessions import open_session

SAMPLES = 2048  # values that are looked at of each map and scan
MOST = 8192  # of these, for the search of the range
SHRINK = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.22, 0.16, 0.12, 0.09, 0.06, 0.04)  # parts of the largest range


def halves_of(graph: Graph, images: Sequence[np.ndarray]) -> dict[str, Halves]:
    """What each LeakyRelu behind a convolution takes, by the name of its output."""
    graph = floating(graph)
    graph.outputs = []
    leaky = leaky_convolutions(graph)
    for node in leaky:
        shape = graph.shapes[node.output]
        above = graph.add("Relu", [node.inputs[0]], shape)
        below = graph.add("Sub", [above, node.inputs[0]], shape)
        for half in (above, below):
            square = graph.add("Mul", [half, half], shape)
            for part in (half, square):
                _by_channel(graph, "ReduceMean", part)
        _by_channel(graph, "ReduceMax", below)
    if not leaky:
        return {}
    every = _run(graph, images)
    found = {}
    for i, node in enumerate(leaky):
        parts = [np.asarray([results[5 * i + j] for results in every]) for j in range(5)]  # each (images, C)
        mean, mean_square, low, low_square = (part.mean(axis=0, dtype=np.float64) for part in parts[:4])
        lowest = parts[4].max(axis=0)
        found[node.output] = Halves(mean, mean_square - mean**2, low, low_square - low**2, lowest)
    return found


def find_widths(graph: Graph, names: Collection[str], images: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """How far the values of each channel (C,) reach: geometric mean of their range and their root mean square.

    Measured: the range alone gives rare large values too much weight, the root mean square alone too little.
    """
    graph = floating(graph)
    names = sorted(names)
    graph.outputs = []
    for name in names:
        for op in ("ReduceMin", "ReduceMax"):
            _by_channel(graph, op, name)
        _by_channel(graph, "ReduceMean", graph.add("Mul", [name, name], graph.shapes[name]))
    every = _run(graph, images)
    widths = {}
    for i, name in enumerate(names):
        low = np.min([results[3 * i] for results in every], axis=0).clip(max=0)
        high = np.max([results[3 * i + 1] for results in every], axis=0).clip(min=0)
        square = np.mean([results[3 * i + 2] for results in every], axis=0, dtype=np.float64)
        widths[name] = np.sqrt((high - low) * np.sqrt(square))
    return widths


def find_ranges(graph: Graph, names: Collection[str], images: Sequence[np.ndarray]) -> dict[str, tuple[float, float]]:
    """Range of each value, that of least error when it is cut into 255 steps."""
    graph = floating(graph)
    names = sorted(names)
    graph.outputs = []
    for name in names:
        flat = graph.add("Reshape", [name, graph.integers(-1)], (f"size of {name}",))
        graph.outputs.append(_samples(graph, flat))
        for op in ("ReduceMin", "ReduceMax"):
            graph.outputs.append(graph.add(op, [flat], (), keepdims=0))
    samples: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for results in _run(graph, images):
        for i, name in enumerate(names):
            samples[name].append(np.concatenate([np.ravel(part) for part in results[3 * i : 3 * i + 3]]))
    return {name: best_range(np.concatenate(values)) for name, values in samples.items()}


def best_range(values: np.ndarray) -> tuple[float, float]:
    """The range whose 255 steps reproduce `values` best; it holds zero. Three digits, the same on every machine."""
    low, high = min(0.0, float(values.min())), max(0.0, float(values.max()))
    values = values[:: -(-len(values) // MOST)]
    below = above = 1.0
    for _ in range(2):  # one end, then the other
        above = min(SHRINK, key=lambda part: _error(values, low * below, high * part))
        if low < 0:
            below = min(SHRINK, key=lambda part: _error(values, low * part, high * above))
    return float(f"{low * below:.3g}"), float(f"{high * above:.3g}")


def _error(values: np.ndarray, low: float, high: float) -> float:
    """Mean of the errors of `values` in the 255 steps from `low` to `high`, each to the power of 1.5.

    Measured: 2 gives rare large values too much weight, 1 too little.
    """
    step = max((high - low) / 255, 1e-12)
    first = np.rint(low / step)
    error = np.abs(np.clip(np.rint(values / step), first, first + 255) * step - values)
    return float((error * np.sqrt(error)).mean())


def floating(graph: Graph) -> Graph:
    """A copy of `graph` that ONNX knows all operations of."""
    graph = graph.copy()
    for node in graph.nodes:
        if node.op == "SoftPool":
            shape = graph.sizes(node.inputs[0])
            with graph.before(node):
                top = graph.add("ReduceMax", [node.inputs[0]], (1, 1, 1, 1), axes=[0, 1, 2, 3], keepdims=1)
                below = graph.add("Sub", [node.inputs[0], top], shape)
                pooled = expand_soft_pool(graph, below, shape, lambda part: part, np.inf, np.zeros(shape[1]))
                result = graph.add("Add", [pooled, top], graph.shapes[node.output])
            graph.supplant(node, result)
    return graph


def _samples(graph: Graph, flat: str) -> str:
    """About SAMPLES of the values of a row, at equal steps: odd ones, so that they meet every column."""
    size = graph.add("Reshape", [graph.add("Size", [flat], ()), graph.integers(1)], (1,))
    pairs = graph.add("Div", [size, graph.integers(2 * SAMPLES)], (1,))
    step = graph.add("Add", [graph.add("Add", [pairs, pairs], (1,)), graph.integers(1)], (1,))
    zero = graph.integers(0)
    return graph.add("Slice", [flat, zero, size, zero, step], (f"samples of {flat}",))


def _by_channel(graph: Graph, op: str, name: str) -> None:
    """Make a reduction (C,) of a map (1, C, H, W) a result of the graph."""
    graph.outputs.append(graph.add(op, [name], graph.shapes[name][1:2], axes=[0, 2, 3], keepdims=0))


def _run(graph: Graph, images: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    graph.sweep()
    session = open_session(onnx_bytes(graph), threads=2)
    (name,) = graph.inputs
    return [session.run(graph.outputs, {name: image}) for image in images]

"""Rewriting for the integer graph: the channels of a map get to reach as far as each other.

An integer map has one scale, so that a channel of small values beside one of large values is left with few steps. But a
factor for a channel passes through all that is linear or a ReLU: the convolution before is multiplied by it, those
behind are divided by it, and no result changes. Nagel et al., "Data-free quantization through weight equalization and
bias correction" (ICCV 2019), do so for two layers in a row; here it passes sums, joins, gates, pools and shuffles.
"""

from collections.abc import Mapping

import numpy as np

from export.graph.convolutions import bias_of, is_plain, scale_kernel
from export.graph.graph import Graph, Node
from export.graph.operations import traits
from export.int8.shifts import channel_constant, shift_of

FIXED = 0  # number of all channels that have to stay as they are
LEAST = 1e-3  # part of the widest channel of a map that a channel counts for at least


def equalise(graph: Graph, widths: Mapping[str, np.ndarray]) -> None:
    """Multiply channels so that those of one map reach as far as each other, where that changes no result.

    widths: (C,) how far the values of each channel reach, of every map that becomes integers.
    """
    numbers = tied_channels(graph)
    factors = _factors(numbers, widths)
    for node in graph.nodes:
        if is_plain(node):
            after, before = factors[numbers[node.output]], factors[numbers[node.inputs[0]]]
            ratio = after[:, None, None, None] / before[None, :, None, None]
            scale_kernel(graph, node, ratio, bias_of(graph, node) * after)
        elif (shift := shift_of(graph, node)) is not None:
            constant = channel_constant(graph, shift * factors[numbers[node.output]])
            graph.rewire(node, [node.inputs[0], constant])
    graph.sweep()


def _factors(numbers: Mapping[str, np.ndarray], widths: Mapping[str, np.ndarray]) -> np.ndarray:
    """Factor of every number: channels reach as far as those that stay in the same map, or to one."""
    reach = np.zeros(1 + max(int(every.max()) for every in numbers.values()))
    target = np.zeros_like(reach)
    for name, width in widths.items():
        np.maximum.at(reach, numbers[name], np.maximum(width, LEAST * width.max()))
        staying = width[numbers[name] == FIXED]
        if staying.size:
            np.maximum.at(target, numbers[name], staying.max())
    factors = np.where(target > 0, target, 1) / np.where(reach > 0, reach, 1)
    factors[FIXED] = 1
    return factors


def tied_channels(graph: Graph) -> dict[str, np.ndarray]:
    """A number (C,) for every channel of every map (1, C, H, W): those of one number can only change together."""
    ties = _Ties(graph)
    for node in graph.nodes:
        ties.add(node)
    return ties.found()


class _Ties:
    """Numbers of channels, and which of them are tied to each other."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.parent = [FIXED]
        self.numbers: dict[str, np.ndarray] = {}

    def add(self, node: Node) -> None:
        """Number the channels of what a node computes."""
        maps = [name for name in node.inputs if name in self.numbers]
        found = self._numbers(node, maps) if len(self.graph.shapes[node.output]) == 4 else None
        if found is None:
            for name in maps:
                self._fix(self.numbers[name])
        if len(self.graph.shapes[node.output]) == 4:
            self.numbers[node.output] = np.zeros(self.graph.channels(node.output), int) if found is None else found

    def found(self) -> dict[str, np.ndarray]:
        """The numbers, the same for tied channels; results and inputs of the graph stay as they are."""
        for name in self.numbers.keys() & set(self.graph.outputs):
            self._fix(self.numbers[name])
        roots = np.asarray([self._root(number) for number in range(len(self.parent))])
        inputs = {name: np.zeros(self.graph.channels(name), int) for name in self.graph.inputs}
        return inputs | {name: roots[numbers] for name, numbers in self.numbers.items()}

    def _numbers(self, node: Node, maps: list[str]) -> np.ndarray | None:
        """Those of the channels of its output; None where nothing may change."""
        given = [self.numbers[name] for name in maps]
        if is_plain(node):
            numbers = len(self.parent) + np.arange(self.graph.channels(node.output))
            self.parent.extend(numbers.tolist())
            return numbers
        if len(given) == 1 and self._passes(node):
            return given[0]
        if node.op == "Concat" and node.attributes["axis"] == 1 and len(given) == len(node.inputs):
            return np.concatenate(given)
        if node.op == "DepthToSpace" and given:
            return self._shuffled(node, given[0])
        if node.op == "Add" and len(given) == 2 and len({self.graph.shapes[n] for n in (*maps, node.output)}) == 1:
            self._tie(*given)
            return given[0]
        if node.op == "Mul" and len(given) == 2:
            gate, gated = sorted(given, key=lambda numbers: any(self._root(n) != FIXED for n in numbers.tolist()))
            if len(gated) == self.graph.channels(node.output):
                self._fix(gate)
                return gated
        return None

    def _passes(self, node: Node) -> bool:
        """Whether a factor of each channel of its one map can stand behind the node instead of before it."""
        if shift_of(self.graph, node) is not None:
            return True
        if node.op == "Mul":
            return node.inputs[1] in self.graph.weights
        x, y = node.inputs[0], node.output
        return traits(node).passes_factor and self.graph.channels(x) == self.graph.channels(y)

    def _shuffled(self, node: Node, numbers: np.ndarray) -> np.ndarray:
        """The channels that become one after a pixel shuffle are tied."""
        size = node.attributes["blocksize"] ** 2
        crd = node.attributes["mode"] == "CRD"
        groups = numbers.reshape(-1, size) if crd else numbers.reshape(size, -1).T
        for i in range(1, size):
            self._tie(groups[:, 0], groups[:, i])
        return groups[:, 0]

    def _fix(self, numbers: np.ndarray) -> None:
        self._tie(numbers, np.full_like(numbers, FIXED))

    def _tie(self, some: np.ndarray, others: np.ndarray) -> None:
        for pair in zip(some.tolist(), others.tolist(), strict=True):
            low, high = sorted(map(self._root, pair))
            self.parent[high] = low

    def _root(self, number: int) -> int:
        while self.parent[number] != number:
            self.parent[number] = self.parent[self.parent[number]]
            number = self.parent[number]
        return number

"""Graphs for images of any height and width.

A network is traced at one size, of which all numbers of a graph are made. Its sides are multiples of large primes: a
number that is divisible by one of them follows the rows, by the other the columns. Such numbers are computed from the
image that comes; ONNX Runtime does so once where it is told the size before (`runtime.compute.sessions.open_session`).
"""

import math
from dataclasses import dataclass

import numpy as np

from export.graph.graph import Graph, Shape
from runtime.image.image_net import HEIGHT, WIDTH

STEP = 16  # rows and columns are multiples of it
ROW_PRIME, COLUMN_PRIME = 1009, 1013


def any_size(channels: int) -> tuple[int, int, int, int]:
    """The shape (1, channels, H, W) to trace a network at that is for images of any size."""
    return 1, channels, STEP * ROW_PRIME, STEP * COLUMN_PRIME


@dataclass(frozen=True)
class Follows:
    """rest * H^rows * W^columns / STEP^(rows + columns)."""

    rows: int
    columns: int
    rest: int

    @classmethod
    def of(cls, number: int) -> "Follows":
        """How a number of a graph that was traced at `any_size` depends on the size."""
        powers = [0, 0]
        for i, prime in enumerate((ROW_PRIME, COLUMN_PRIME)):
            while number and number % prime == 0:
                number, powers[i] = number // prime, powers[i] + 1
        return cls(powers[0], powers[1], number)

    @property
    def divisor(self) -> int:
        return int(STEP ** (self.rows + self.columns))


def named(shape: Shape) -> Shape:
    """A shape with names for what follows the size."""
    return tuple(size if isinstance(size, str) else _name(Follows.of(size), size) for size in shape)


def _name(follows: Follows, number: int) -> int | str:
    if follows.divisor == 1:
        return number
    sides = [HEIGHT] * follows.rows + [WIDTH] * follows.columns
    share = math.gcd(follows.rest, follows.divisor)
    times, over = follows.rest // share, follows.divisor // share
    return "*".join(sides + [str(times)] * (times > 1)) + (f"/{over}" if over > 1 else "")


def follow_size(graph: Graph) -> Graph:
    """The graph with every stored number that follows the size computed from that of the image; itself without any."""
    found = [
        name
        for name, weight in graph.weights.items()
        if weight.values.dtype == np.int64 and any(Follows.of(int(n)).divisor > 1 for n in weight.values.flat)
    ]
    if not found:
        return graph
    graph = graph.copy()
    with graph.before(graph.nodes[0]):
        numbers = _Numbers(graph)
        for name in found:
            graph.replace(name, numbers.list(graph.weights[name].values))
    graph.sweep()
    return graph


class _Numbers:
    """Writes nodes that compute numbers, each (1,) int64, once."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        (image,) = graph.inputs
        self.shape = graph.add("Shape", [image], (4,))
        self.known: dict[int, str] = {}

    def list(self, values: np.ndarray) -> str:
        """Numbers in a row (n,)."""
        parts = [self.one(int(value)) for value in values.flat]
        return parts[0] if len(parts) == 1 else self.graph.add("Concat", parts, (len(parts),), axis=0)

    def one(self, number: int) -> str:
        if number not in self.known:
            self.known[number] = self._computed(number)
        return self.known[number]

    def _computed(self, number: int) -> str:
        follows = Follows.of(number)
        if follows.divisor == 1:
            return self.graph.integers(number)
        sides = [self._side(2)] * follows.rows + [self._side(3)] * follows.columns
        product, *others = [*sides, *([self.graph.integers(follows.rest)] if follows.rest != 1 else [])]
        for factor in others:
            product = self.graph.add("Mul", [product, factor], (1,))
        return self.graph.add("Div", [product, self.graph.integers(follows.divisor)], (1,))

    def _side(self, axis: int) -> str:
        return self.graph.add("Gather", [self.shape, self.graph.integers(axis)], (1,), axis=0)

"""The point head as an ONNX graph over neighbour tables, for execution providers on a GPU (paper, Sec. III-D).

A sparse convolution becomes Gather, Reshape and Gemm: the rows of all neighbours of a voxel side by side, a row of
zeros where there is none, times all kernel offsets below each other. 3x3x3 kernels take one z plane (9 offsets) at a
time: a third of the memory, and the sums stay inside Gemm. Means and interpolations go over tables too, so nothing
scatters and every run adds in the same order. `runtime/head/onnx_engine.py` says what the tables hold, and makes them.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from onnx import TensorProto

from export.graph.graph import Graph, Shape
from export.graph.serialise import onnx_bytes
from runtime.bundle.head_shape import PointHeadConfig
from runtime.head.onnx_engine import joins
from runtime.head.weights import Layer, layers

PLANES = 3  # parts of a 3x3x3 kernel
Value = str  # name of a value of the graph
Rows = str  # symbol of a number of rows: voxels0 (of stride 1), voxels1 (of stride 2), ...


def head_bytes(weights: Mapping[str, np.ndarray], config: PointHeadConfig) -> bytes:
    """The ONNX model of a point head; `weights` as of `export.bundle.head_weights.head_arrays`. Same bytes always."""
    return onnx_bytes(_HeadGraph(weights, config).build(), "point_head")


def inputs(config: PointHeadConfig) -> dict[str, tuple[int, Shape]]:
    """Element type and shape of every input; see `runtime.head.onnx_engine` for what they hold."""
    depth = len(config.down)
    found: dict[str, tuple[int, Shape]] = {"features": (TensorProto.FLOAT, ("voxels0", config.in_channels))}
    for level in range(depth + 1):
        found[f"neighbours{level}"] = (TensorProto.INT32, (f"voxels{level}", 27))
    for level in range(depth):
        found[f"children{level + 1}"] = (TensorProto.INT32, (f"voxels{level + 1}", 8))
        found[f"place{level}"] = (TensorProto.INT32, (f"voxels{level}",))
    for level in joins(config):
        found[f"corners{level}"] = (TensorProto.INT32, ("voxels0", 8))
        found[f"nearness{level}"] = (TensorProto.FLOAT, ("voxels0", 8))
        found[f"share{level}"] = (TensorProto.FLOAT, (f"voxels{level}", 1))
    return found


class _HeadGraph:
    """Writes the network down, layer by layer; the methods are those of `mos_model.networks.point_head`."""

    def __init__(self, weights: Mapping[str, np.ndarray], config: PointHeadConfig) -> None:
        self.config, self.weights, self.graph = config, weights, Graph()
        self.layers: dict[str, Layer] = {layer.name: layer for layer in layers(config)}
        self.known: dict[tuple[str, ...], Value] = {}  # values that several layers use
        for name, (kind, shape) in inputs(config).items():
            self.graph.input(name, shape, kind)

    def build(self) -> Graph:
        config, depth = self.config, len(self.config.down)
        x = z = self.relu(self.same("stem", "features", 0))  # (V0, c)
        skips = [x]
        for n in range(1, depth + 1):
            x = self.down(f"stage{n}.0", x, n)
            x = self.residual(f"stage{n}.2", self.residual(f"stage{n}.1", x, n), n)
            skips.append(x)
        x, z = self.join(x, z, depth, 0)
        for n in range(1, depth + 1):
            level = depth - n
            up = self.up(f"up{n}.0", x, level)
            x = self.add("Concat", [up, skips[level]], level, self.width(up) + self.width(skips[level]), axis=1)
            x = self.residual(f"up{n}.1.1", self.residual(f"up{n}.1.0", x, level), level)
            if n == config.fuse_after_up:
                x, z = self.join(x, z, level, 1)
        z = self.relu(self.dense(f"point_transforms.{len(joins(config))}", z))
        logits = self.dense("classifier", self.add("Add", [x, z], 0, self.width(x)))  # (V0, 3)
        self.graph.finish(self.add("Softmax", [logits], 0, 3, axis=1), "probabilities")
        return self.graph

    def same(self, name: str, x: Value, level: int) -> Value:
        """3x3x3 convolution within a scale, before its ReLU."""
        layer, total = self.layers[name], self.bias(name)
        size = layer.offsets // PLANES
        for plane in range(PLANES):
            table = self.columns(f"neighbours{level}", plane * size, size)
            weight = self.weight(name, f"{name}.{plane}", slice(plane * size, (plane + 1) * size))
            total = self.add("Gemm", [self.gathered(x, table, level, size), weight, total], level, layer.outputs)
        return total

    def residual(self, name: str, x: Value, level: int) -> Value:
        total = self.same(f"{name}.conv2", self.relu(self.same(f"{name}.conv1", x, level)), level)
        if f"{name}.shortcut" in self.layers:  # its bias is part of conv2's
            weight = self.weight(f"{name}.shortcut", f"{name}.shortcut")
            return self.relu(self.add("Gemm", [x, weight, total], level, self.width(total)))
        return self.relu(self.add("Add", [total, x], level, self.width(total)))

    def down(self, name: str, x: Value, level: int) -> Value:
        """2x2x2 convolution from the finer scale to that of `level`."""
        rows = self.gathered(x, f"children{level}", level, 8)
        outputs = self.layers[name].outputs
        return self.relu(self.add("Gemm", [rows, self.weight(name, name), self.bias(name)], level, outputs))

    def up(self, name: str, x: Value, level: int) -> Value:
        """Transposed 2x2x2 convolution to the scale of `level`: each voxel takes its octant of its parent's product."""
        layer = self.layers[name]
        every = self.add("MatMul", [x, self.weight(name, name, across=True)], level + 1, 8 * layer.outputs)
        each = self.add("Reshape", [every, self.integers(-1, layer.outputs)], level + 1, layer.outputs)
        own = self.add("Gather", [each, f"place{level}"], level, layer.outputs, axis=0)
        return self.relu(self.add("Add", [own, self.bias(name)], level, layer.outputs))

    def join(self, x: Value, z: Value, level: int, i: int) -> tuple[Value, Value]:
        """Point branch meets voxel branch: z = v2p(x) + mlp(z), x = p2v(z)."""
        z = self.relu(self.dense(f"point_transforms.{i}", z))
        z = self.summed(x, f"corners{level}", 0, z, f"nearness{level}")
        total = z
        for coarse in range(1, level + 1):
            total = self.summed(total, f"children{coarse}", coarse)
        return self.add("Mul", [total, f"share{level}"], level, self.width(z)), z

    def dense(self, name: str, x: Value) -> Value:
        """A dense layer of the point branch, before its ReLU."""
        return self.add("Gemm", [x, self.weight(name, name), self.bias(name)], 0, self.layers[name].outputs)

    def relu(self, x: Value) -> Value:
        output = self.add("Relu", [x], 0, self.width(x))
        self.graph.shapes[output] = self.graph.shapes[x]
        return output

    def summed(self, x: Value, table: Value, level: int, total: Value | None = None, factors: Value = "") -> Value:
        """`total` + the sum over the 8 columns of the table (times those of `factors`) of the rows that they name."""
        width = self.width(x)
        for column in range(8):
            rows = self.add("Gather", [self.filled(x), self.column(table, column)], level, width, axis=0)
            if factors:
                rows = self.add("Mul", [rows, self.columns(factors, column, 1)], level, width)
            total = rows if total is None else self.add("Add", [total, rows], level, width)
        assert total is not None
        return total

    def gathered(self, x: Value, table: Value, level: int, size: int) -> Value:
        """The rows that each row of a table (V, size) names, side by side: (V, size * c)."""
        width = size * self.width(x)
        rows = self.add("Gather", [self.filled(x), table], level, width, axis=0)  # (V, size, c)
        return self.add("Reshape", [rows, self.integers(-1, width)], level, width)

    def filled(self, x: Value) -> Value:
        """`x` with a row of zeros at its end, for neighbours that are missing."""
        if ("filled", x) not in self.known:
            width = self.width(x)
            if ("zeros", str(width)) not in self.known:
                self.known["zeros", str(width)] = self.graph.weight("zeros", np.zeros((1, width), np.float32))
            self.known["filled", x] = self.add("Concat", [x, self.known["zeros", str(width)]], 0, width, axis=0)
        return self.known["filled", x]

    def columns(self, table: Value, start: int, number: int) -> Value:
        """`number` columns of a table."""
        key = ("columns", table, str(start), str(number))
        if key not in self.known:
            bounds = [self.integers(start), self.integers(start + number), self.integers(1)]
            self.known[key] = self.graph.add("Slice", [table, *bounds], ())
        return self.known[key]

    def column(self, table: Value, number: int) -> Value:
        """One column of a table, as a vector."""
        key = ("column", table, str(number))
        if key not in self.known:
            self.known[key] = self.graph.add("Reshape", [self.columns(table, number, 1), self.integers(-1)], ())
        return self.known[key]

    def weight(self, name: str, part: str, offsets: slice = slice(None), across: bool = False) -> Value:
        """Kernel of a layer as a matrix: offsets below each other, or beside each other (`across`)."""
        layer, values, scale = self.layers[name], self.weights[f"{name}.weight"], self.weights.get(f"{name}.scale")
        values = values.reshape(-1, sum(layer.inputs), layer.outputs)[offsets]
        if across:
            scale = None if scale is None else np.tile(scale, len(values))
            values = values.transpose(1, 0, 2).reshape(values.shape[1], -1)
        else:
            values = values.reshape(-1, layer.outputs)
        return self.graph.weight(f"{part}.weight", values, scale)

    def bias(self, name: str) -> Value:
        return self.graph.weight(f"{name}.bias", self.weights[f"{name}.bias"].astype(np.float32))

    def integers(self, *values: int) -> Value:
        key = ("integers", *map(str, values))
        if key not in self.known:
            self.known[key] = self.graph.integers(*values)
        return self.known[key]

    def add(self, op: str, names: list[Value], level: int, width: int, **attributes: Any) -> Value:
        """A node whose output has a row for each voxel of a scale."""
        return self.graph.add(op, names, (f"voxels{level}", width), **attributes)

    def width(self, x: Value) -> int:
        """Channels of a value."""
        return self.graph.channels(x)

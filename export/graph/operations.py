"""What the rewrites may take for granted of an operation: each described once, on maps (1, C, H, W)."""

from dataclasses import dataclass

from export.graph.graph import Node


@dataclass(frozen=True)
class Operation:
    """Traits of an operation. One that is not in the table has none, and no rewrite goes past it."""

    elementwise: bool = False  # each number of its one input by itself, all channels alike
    moves: bool = False  # its numbers are those of its first input, in other places
    passes_factor: bool = False  # f * x gives f times as much, for an f > 0 of each channel that stays one
    passes_shift: bool = False  # x + s gives s more, for an s of each channel; where it does not pad
    integer: bool = False  # ONNX Runtime has a form of it for 8-bit integers: QLinear...
    clips: bool = False  # ... whose lower end can do the work of a ReLU behind it
    told_layout: bool = False  # ... that has to be told that the channels come last


OPERATIONS = {
    "Conv": Operation(integer=True, clips=True, told_layout=True),
    "Add": Operation(passes_shift=True, integer=True, clips=True),
    "Mul": Operation(integer=True),
    "Concat": Operation(passes_shift=True, integer=True),
    "Relu": Operation(elementwise=True, passes_factor=True),
    "LeakyRelu": Operation(elementwise=True, passes_factor=True, integer=True),
    "Sigmoid": Operation(elementwise=True, integer=True),
    "Clip": Operation(elementwise=True),
    "AveragePool": Operation(passes_factor=True, passes_shift=True, integer=True, told_layout=True),
    "GlobalAveragePool": Operation(passes_factor=True, passes_shift=True, integer=True, told_layout=True),
    "SoftPool": Operation(passes_shift=True),  # of export.int8.integer_forms
    "Expand": Operation(passes_factor=True),
    "Slice": Operation(moves=True, passes_factor=True),
    "Pad": Operation(moves=True, passes_factor=True),
    "Resize": Operation(moves=True, passes_factor=True),
    "DepthToSpace": Operation(moves=True),
    "Reshape": Operation(moves=True),
    "Transpose": Operation(moves=True),
}
UNKNOWN = Operation()


def traits(node: Node) -> Operation:
    """What is known of the operation of a node."""
    return OPERATIONS.get(node.op, UNKNOWN)

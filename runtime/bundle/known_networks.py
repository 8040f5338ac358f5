"""What an ONNX file of a bundle may hold: the operations that `mos export` writes, and weights that lie in the file.

A file of a stranger could hold loops without end, functions, networks within networks, or weights that lie elsewhere on
the disk. None of them gets as far as ONNX Runtime.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from runtime.bundle.wire import fields, whole_numbers
from runtime.errors import BundleError
from runtime.files import read_ordinary

LARGEST = 1 << 28  # bytes of a file
MOST_NODES = 4096
OPSETS = {"": 17, "com.microsoft": 1}  # the newest version of each domain
OPERATIONS = {
    "": {
        *(
            "Add",
            "AveragePool",
            "BatchNormalization",
            "Cast",
            "Clip",
            "Concat",
            "Conv",
            "ConvTranspose",
            "DepthToSpace",
        ),
        *("DequantizeLinear", "Div", "Exp", "Expand", "Gather", "Gemm", "GlobalAveragePool", "LeakyRelu", "MatMul"),
        *("Max", "Min", "Mul", "Pad", "QuantizeLinear", "Range", "Reciprocal", "ReduceMax", "ReduceMean", "ReduceMin"),
        *("ReduceSum", "Relu", "Reshape", "Resize", "Shape", "Sigmoid", "Size", "Slice", "Softmax", "Squeeze", "Sub"),
        *("Sum", "Tanh", "Transpose"),
    },
    "com.microsoft": {
        *("QLinearAdd", "QLinearAveragePool", "QLinearConcat", "QLinearConv", "QLinearGlobalAveragePool"),
        *("QLinearLeakyRelu", "QLinearMul", "QLinearSigmoid"),
    },
}
WINDOWS = {"pads": 64, "strides": 64, "dilations": 64, "kernel_shape": 64, "output_padding": 64, "blocksize": 64}

# Numbers of fields, by onnx.proto: https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
GRAPH, OPSET, TRAINING, FUNCTIONS = 7, 8, 20, 25  # of a model
NODE, INITIALISER, SPARSE = 1, 5, 15  # of a graph
OPERATION, ATTRIBUTE, DOMAIN = 4, 5, 7  # of a node
NAME, INTEGER, TENSOR, INTEGERS, TENSORS = 1, 3, 5, 8, 10  # of an attribute
INNER = (6, 11, 22, 23)  # graphs and sparse tensors of an attribute
EXTERNAL, LOCATION = 13, 14  # of a tensor


@dataclass
class Contents:
    """What was found in a file."""

    operations: dict[str, int] = field(default_factory=dict)  # how often each, by "domain.name" or name
    wrong: list[str] = field(default_factory=list)  # what a network of ours never has

    @property
    def nodes(self) -> int:
        """All of them."""
        return sum(self.operations.values())


def check_network(path: Path) -> Contents:
    """What a file holds. Raises BundleError where that is not such as `mos export` writes."""
    try:
        found = contents(memoryview(read_ordinary(path, LARGEST)))
    except OSError as error:
        raise BundleError(f"{path}: cannot be read ({error.strerror}); get the bundle again") from error
    except (ValueError, UnicodeDecodeError) as error:
        raise BundleError(f"{path}: is no ONNX file ({error}); get the bundle again") from error
    if found.wrong:
        reasons = "; ".join(list(dict.fromkeys(found.wrong))[:3])
        raise BundleError(f"{path}: is no network that `mos export` writes, and is not loaded: {reasons}")
    return found


def contents(model: memoryview) -> Contents:
    """Look through the bytes of a model. Raises ValueError where they are none."""
    found, graphs = Contents(), 0
    for number, value in fields(model):
        if number in (TRAINING, FUNCTIONS):
            found.wrong.append("it holds functions" if number == FUNCTIONS else "it holds a training")
        if number == OPSET:
            _check_opset(_bytes(value), found)
        if number == GRAPH:
            graphs += 1
            _look_at_graph(_bytes(value), found)
    if graphs != 1 or not found.operations:
        raise ValueError("it holds no network")
    return found


def _check_opset(message: memoryview, found: Contents) -> None:
    domain, version = "", 0
    for number, value in fields(message):
        domain = _text(value) if number == 1 else domain
        version = value if number == 2 and isinstance(value, int) else version
    if domain not in OPSETS or version > OPSETS[domain]:
        found.wrong.append(f"operations of {domain or 'ONNX'!r:.40} in version {version}")


def _look_at_graph(graph: memoryview, found: Contents) -> None:
    for number, value in fields(graph):
        if number == NODE:
            _look_at_node(_bytes(value), found)
        elif number == INITIALISER:
            _look_at_tensor(_bytes(value), found)
        elif number == SPARSE:
            found.wrong.append("sparse weights")
    if found.nodes > MOST_NODES:
        found.wrong.append(f"{found.nodes:,} operations, up to {MOST_NODES:,} are known")


def _look_at_node(node: memoryview, found: Contents) -> None:
    name = domain = ""
    attributes = []
    for number, value in fields(node):
        if number == OPERATION:
            name = _text(value)
        elif number == DOMAIN:
            domain = _text(value)
        elif number == ATTRIBUTE:
            attributes.append(_bytes(value))
    full = f"{domain}.{name}" if domain else name
    found.operations[full] = found.operations.get(full, 0) + 1
    if name not in OPERATIONS.get(domain, ()):
        found.wrong.append(f"the operation {full!r:.60}")
    for attribute in attributes:
        _look_at_attribute(attribute, full, found)


def _look_at_attribute(attribute: memoryview, operation: str, found: Contents) -> None:
    name, numbers = "", []
    for number, value in fields(attribute):
        if number == NAME:
            name = _text(value)
        elif number in (INTEGER, INTEGERS):
            numbers += whole_numbers(value)
        elif number in (TENSOR, TENSORS):
            _look_at_tensor(_bytes(value), found)
        elif number in INNER:
            found.wrong.append(f"a network within {operation!r:.60}")
    if max(numbers, default=0) > WINDOWS.get(name, 1 << 64):
        found.wrong.append(f"{name} of {max(numbers)} in {operation}")


def _look_at_tensor(tensor: memoryview, found: Contents) -> None:
    for number, value in fields(tensor):
        if number == EXTERNAL or (number == LOCATION and value != 0):
            found.wrong.append("weights outside of the file")


def _bytes(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise ValueError("a number in the place of something larger")
    return value


def _text(value: int | memoryview) -> str:
    return bytes(_bytes(value)).decode()


def described(found: Contents) -> Iterator[str]:
    """In words, for who asks what was looked at."""
    yield f"{found.nodes} operations of {len(found.operations)} kinds, all of them such as `mos export` writes"
    yield "no network within, no function, no weight outside of the file"

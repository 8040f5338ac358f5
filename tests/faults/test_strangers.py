"""Bundles of strangers: nothing but what the export writes gets as far as ONNX Runtime."""

import io
import re
import zipfile

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from runtime.bundle.known_networks import OPERATIONS, check_network
from runtime.bundle.loading import LARGEST_WEIGHTS, default_bundle_path, load_bundle
from runtime.bundle.manifest import IMAGE_NET, POINT_HEAD
from runtime.bundle.wire import fields
from runtime.commands.main import main
from runtime.errors import BundleError
from tests.support.bundles import with_file
from tests.support.paths import BUNDLE, ROOT

FLOAT = TensorProto.FLOAT


def model(*nodes, stored=(), functions=(), opset=17, domains=()):
    value = helper.make_tensor_value_info
    outputs = [value(name, FLOAT, [1, 3, "h", "w"]) for name in ("probabilities", "features")]
    graph = helper.make_graph(nodes, "g", [value("image", FLOAT, [1, 13, "h", "w"])], outputs, stored)
    opsets = [helper.make_opsetid("", opset), *(helper.make_opsetid(domain, 1) for domain in domains)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=8, functions=functions)


def endless():
    """Counts to 2^62."""
    value = helper.make_tensor_value_info
    nodes = [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Identity", ["x"], ["y"])]
    given = [value("i", TensorProto.INT64, []), value("go", TensorProto.BOOL, []), value("x", FLOAT, None)]
    body = helper.make_graph(nodes, "body", given, [value("on", TensorProto.BOOL, []), value("y", FLOAT, None)])
    count = numpy_helper.from_array(np.array(1 << 62), "count")
    loop = helper.make_node("Loop", ["count", "", "image"], ["probabilities"], body=body)
    return model(loop, helper.make_node("Relu", ["image"], ["features"]), stored=[count])


def external():
    """Weights that are read from /etc."""
    tensor = numpy_helper.from_array(np.zeros(4, np.float32), "weights")
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../../etc/passwd")
    return model(helper.make_node("Add", ["image", "weights"], ["probabilities"]), stored=[tensor])


def hidden():
    """A known operation with a network within."""
    relu = helper.make_node("Relu", ["image"], ["probabilities"])
    relu.attribute.append(helper.make_attribute("body", endless().graph))
    return model(relu)


def with_function():
    inner = helper.make_node("Relu", ["x"], ["y"])
    made = helper.make_function("own", "Relu", ["x"], ["y"], [inner], [helper.make_opsetid("", 17)])
    return model(helper.make_node("Relu", ["image"], ["probabilities"]), functions=[made])


def wide():
    """Pixels around an image, until there is no memory left."""
    kernel = numpy_helper.from_array(np.zeros((3, 13, 1, 1), np.float32), "kernel")
    return model(helper.make_node("Conv", ["image", "kernel"], ["probabilities"], pads=[1 << 20] * 4), stored=[kernel])


MODELS = {
    "the operation 'Loop'": endless,
    "weights outside": external,
    "a network within 'Relu'": hidden,
    "it holds functions": with_function,
    "pads of": wide,
    "the operation 'own.thing'": lambda: model(helper.make_node("thing", ["image"], ["probabilities"], domain="own")),
    "'ONNX' in version 21": lambda: model(helper.make_node("Relu", ["image"], ["probabilities"]), opset=21),
    "'own' in version 1": lambda: model(helper.make_node("Relu", ["image"], ["probabilities"]), domains=["own"]),
    "5,000 operations": lambda: model(*[helper.make_node("Relu", ["image"], [f"x{i}"]) for i in range(5000)]),
}


@pytest.mark.parametrize("reason", MODELS)
def test_a_network_that_no_export_writes(bundle, reason):
    with pytest.raises(BundleError, match=rf"image_net\.onnx: .*{reason}"):
        load_bundle(with_file(bundle, IMAGE_NET, MODELS[reason]().SerializeToString()))


@pytest.mark.parametrize("data", [b"", b"x", b"\x08" + b"\xff" * 20, b"\x3a\xff\xff\xff\x7f", b"\x3d1234", b"\x0b"])
def test_bytes_that_are_no_network(bundle, data):
    with pytest.raises(BundleError, match="is no ONNX file"):
        load_bundle(with_file(bundle, IMAGE_NET, data))


def test_a_network_that_is_cut_off(bundle):
    data = (bundle / IMAGE_NET).read_bytes()
    for size in np.random.default_rng(0).integers(len(data), size=50):
        with pytest.raises(BundleError, match=r"image_net\.onnx: is no"):
            load_bundle(with_file(bundle, IMAGE_NET, data[:size]))


@pytest.mark.parametrize(
    "path", [*BUNDLE.glob("*.onnx"), *(ROOT / "models").glob("*/*.onnx")], ids=lambda path: path.name
)
def test_the_reader_finds_what_the_library_of_onnx_does(path):
    found = check_network(path).operations
    nodes = onnx.load(path).graph.node
    names = [f"{node.domain}.{node.op_type}" if node.domain else node.op_type for node in nodes]
    assert found == {name: names.count(name) for name in names}


def test_what_the_export_can_write_is_known():
    known = {name for names in OPERATIONS.values() for name in names}
    sources = "".join(path.read_text() for path in (ROOT / "export").rglob("*.py"))
    written = set(re.findall(r"(?:add|unary|binary|make_node)\(\s*\"([A-Z]\w+)\"", sources))
    assert len(written) > 30
    assert written - known == {"SoftPool"}  # which is rewritten before it is stored


def test_fields_of_a_message():
    tensor = helper.make_tensor("name", FLOAT, [2], [1.0, 2.0])
    found = dict(fields(memoryview(tensor.SerializeToString())))
    assert bytes(found[8]) == b"name"
    assert found[2] == FLOAT


def bomb(size):
    """An archive of one array of zeros, so many bytes."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f4", "fortran_order": False, "shape": (size // 4,)})
    file = io.BytesIO()
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("stem.weight.npy", "w", force_zip64=True) as member,
    ):
        member.write(head.getvalue())
        block = bytes(1 << 24)
        for _ in range(size // len(block)):
            member.write(block)
    return file.getvalue()


def test_weights_that_unpack_to_more_than_they_may(bundle):
    data = bomb(LARGEST_WEIGHTS + (1 << 24))
    assert len(data) < LARGEST_WEIGHTS / 100
    loaded = load_bundle(with_file(bundle, POINT_HEAD, data))
    with pytest.raises(BundleError, match=r"point_head\.npz: .*unpacks to"):
        loaded.point_head()


def test_weights_that_say_to_be_larger_than_all_memory(bundle):
    head = io.BytesIO()
    shape = {"descr": "<f4", "fortran_order": False, "shape": (1 << 50,)}
    np.lib.format.write_array_header_1_0(head, shape)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("stem.weight.npy", head.getvalue())
    with pytest.raises(BundleError, match=r"point_head\.npz"):
        load_bundle(with_file(bundle, POINT_HEAD, file.getvalue())).point_head()


def test_what_was_checked_is_said(capfd):
    assert main(["info", "--verify", str(BUNDLE)]) == 0
    said = capfd.readouterr().out
    for text in ("SHA-256 as the manifest says", "no function", "run with an empty image", "run with a wall"):
        assert text in said


def test_the_bundle_that_ships_is_no_stranger():
    load_bundle(default_bundle_path())

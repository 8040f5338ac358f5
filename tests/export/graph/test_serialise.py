"""The ONNX file of a graph."""

import onnx
import pytest
from torch import nn

from export.graph.serialise import onnx_bytes
from tests.support.graphs import Two, check
from tests.support.models import randomise


@pytest.mark.parametrize("rounded", [False, True])
def test_kernels_that_float16_holds_are_stored_so(rounded):
    conv = nn.Conv2d(6, 4, 3)
    if rounded:
        conv.weight.data = conv.weight.data.half().float()
    graph = check(Two(lambda x, conv, norm: norm(conv(x)), conv, randomise(nn.BatchNorm2d(4))))
    stored = {tensor.name: tensor.data_type for tensor in onnx.load_from_string(onnx_bytes(graph)).graph.initializer}
    assert any(name.endswith(".half") for name in stored) == rounded

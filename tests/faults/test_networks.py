"""A network of a stranger: what it gives is looked at before anything is read by its numbers."""

import json

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from runtime import MosRunner
from runtime.bundle.manifest import IMAGE_NET, MANIFEST
from runtime.errors import BundleError, InferenceError
from tests.support.bundles import with_file

FEATURES = 4


def network(probabilities=3, features=FEATURES, scale=0.0, shrink=False):
    """The bytes of a network whose outputs have these channels; scale: of what stands in them, 0: all is 0.5.

    shrink: one pixel instead of all.
    """
    nodes, weights = [], {}
    for name, count in (("probabilities", probabilities), ("features", features)):
        weights[f"{name}.kernel"] = np.full((count, 13, 1, 1), scale, np.float32)
        weights[f"{name}.bias"] = np.full(count, 0.5, np.float32)
        last = f"{name}.all" if shrink else name
        nodes.append(helper.make_node("Conv", ["image", f"{name}.kernel", f"{name}.bias"], [last]))
        if shrink:
            nodes.append(helper.make_node("ReduceMean", [last], [name], axes=[2, 3], keepdims=1))
    counts = {"probabilities": probabilities, "features": features}
    outputs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, c, "h", "w"]) for n, c in counts.items()]
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 13, "height", "width"])
    stored = [numpy_helper.from_array(value, name) for name, value in weights.items()]
    graph = helper.make_graph(nodes, "network", [image], outputs, stored)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return model.SerializeToString()


def runner_of(bundle, data, **settings):
    return MosRunner(with_file(bundle, IMAGE_NET, data), threads=1, **settings)


@pytest.mark.parametrize("postprocess", ["none", "knn", "head"])
@pytest.mark.parametrize(
    "settings",
    [
        {"shrink": True},
        {"probabilities": 2},
        {"probabilities": 4},
        {"features": 3},
        {"scale": 100.0},  # probabilities of 1,000
    ],
)
def test_outputs_that_are_none(bundle, settings, postprocess):
    with pytest.raises(BundleError, match=r"image_net\.onnx: (gives|is no)"):
        runner_of(bundle, network(**settings), postprocess=postprocess)


def test_values_that_are_not_finite(bundle):
    with pytest.raises((BundleError, InferenceError), match=r"finite|probabilities of"):
        runner_of(bundle, network(scale=np.nan))


def test_a_small_network_is_one(bundle):
    """Else the others would be refused for something else."""
    runner = runner_of(bundle, network(), postprocess="none")
    assert json.loads((bundle / MANIFEST).read_text())["features"] == FEATURES
    result = runner(np.ones((5, 4), np.float32), np.eye(4))
    assert (result.probability == 0.5).all()

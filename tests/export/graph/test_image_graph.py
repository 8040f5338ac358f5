"""The image networks of the paper in ONNX Runtime compute what they compute in PyTorch."""

import pytest

from export.graph.image_graph import Outputs
from mos_model.networks.registry import named_config
from tests.support.graphs import check
from tests.support.models import randomise


@pytest.mark.parametrize("name", ["lmnet", "b", "c", "d", "e", "rt"])
def test_networks_of_the_paper(name):
    network = randomise(named_config(name, 4).build_image_network())
    check(Outputs(network), shape=(1, 13, 32, 48), tolerance=5e-5)

"""What integers cost, and what balances them."""

import dataclasses

import numpy as np
import pytest

from export.graph.image_graph import Outputs
from export.int8.judge import LARGEST_SHIFT, Balance, Judge
from export.int8.prepare import prepare
from export.int8.scenes import Scene
from tests.support.make_tiny import random_network, tiny_config
from tests.support.paths import BUNDLE


def test_the_judge_sees_no_loss_of_a_model_against_itself():
    model = (BUNDLE / "image_net.onnx").read_bytes()
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 3, (64, 256)).astype(np.uint8)
    scenes = [Scene(rng.normal(size=(1, 13, 64, 256)).astype(np.float32), labels)]
    loss = Judge(model, scenes, 0.05, 1).loss(model)
    assert loss.points == 0
    assert loss.difference == 0
    assert loss.before > 0


@pytest.mark.parametrize(("moved", "lacking"), [(-0.3, 0.3), (0.0, 0.0), (0.2, -0.2), (3.0, -LARGEST_SHIFT)])
def test_the_balance_finds_what_a_logit_was_moved_by(moved, lacking):
    config = dataclasses.replace(tiny_config(), point_head=None)
    shape = (1, 13, 64, 256)
    images = [np.random.default_rng(i).normal(size=shape).astype(np.float32) for i in range(2)]
    network = Outputs(random_network(config)[0].eval())
    prepared = prepare(network, shape, images)
    balance = Balance(prepared.model(), images, 1)
    assert balance.lacking(prepared.model(moving=moved)) == pytest.approx(lacking, abs=0.01)

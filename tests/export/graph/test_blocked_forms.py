"""The forms of blocks for ONNX Runtime compute what the blocks compute."""

import copy

import pytest
import torch

from export.graph.blocked_forms import BlockedMetaKernel, BlockedSoftPool, with_blocked_forms
from export.int8.integer_forms import IntegerMetaKernel
from mos_model.networks.blocks import MetaKernel, SoftPool
from mos_model.networks.registry import named_config
from tests.support.models import randomise


@pytest.mark.parametrize("scale", [1.0, 1e4])
def test_soft_pool(scale):
    torch.manual_seed(0)
    x = torch.randn(2, 5, 8, 12) * scale
    torch.testing.assert_close(BlockedSoftPool()(x), SoftPool()(x), rtol=1e-6, atol=1e-6 * scale)


@pytest.mark.parametrize("form", [BlockedMetaKernel, IntegerMetaKernel])
def test_meta_kernel(form):
    torch.manual_seed(0)
    block = MetaKernel(6)
    x, features = torch.randn(2, 5, 8, 12), torch.randn(2, 6, 8, 12)
    torch.testing.assert_close(form(block)(x, features), block(x, features), rtol=1e-5, atol=1e-5)


def test_a_network_is_copied_and_every_block_replaced():
    network = randomise(named_config("v1", 4).build_image_network())
    before = copy.deepcopy(network.state_dict())
    blocked = with_blocked_forms(network)
    kinds = [type(module) for module in blocked.modules()]
    assert not {SoftPool, MetaKernel} & set(kinds)
    assert kinds.count(BlockedSoftPool) == 8
    assert kinds.count(BlockedMetaKernel) == 1
    assert any(isinstance(module, SoftPool) for module in network.modules())
    for key, value in network.state_dict().items():
        assert torch.equal(value, before[key])

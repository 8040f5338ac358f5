import numpy as np
import pytest
import torch
from torch import nn

from mos_model.networks.blocks import POOLINGS, MetaKernel, MotionGuidedAttention, ResBlock, SoftPool, UpBlock
from tests.support import reference_network as reference


def test_soft_pool_is_the_naive_one() -> None:
    x = 5 * torch.randn(2, 3, 6, 8, generator=torch.Generator().manual_seed(1))
    np.testing.assert_allclose(SoftPool()(x), reference.soft_pool(x.numpy()), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("dtype", "huge", "tolerance"),
    [(torch.float32, 3e38, 1e-6), (torch.float16, 65504.0, 1e-3), (torch.bfloat16, 3e38, 1e-2)],
)
def test_soft_pool_does_not_overflow(dtype: torch.dtype, huge: float, tolerance: float) -> None:
    values = [0, 1, -1, 88.5, 89, 1000, -1000, huge / 2, huge, -huge]
    windows = torch.tensor([[a, b, c, d] for a in values for b in values for c in values for d in values])
    x = windows.view(-1, 1, 2, 2).to(dtype).requires_grad_()
    out = SoftPool()(x)
    expected = reference.soft_pool(x.detach().float().numpy())
    np.testing.assert_allclose(out.detach().float(), expected, rtol=tolerance, atol=tolerance)
    out[windows.abs().amax(1) <= 89].sum().backward()
    assert x.grad is not None
    assert x.grad.isfinite().all()


def test_soft_pool_gradient() -> None:
    x = torch.randn(1, 2, 4, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    assert torch.autograd.gradcheck(SoftPool(), x.requires_grad_())


def test_average_pool_counts_its_padding() -> None:
    out = POOLINGS["average"]()(torch.ones(1, 1, 4, 4))
    assert out.flatten().tolist() == pytest.approx([4 / 9, 6 / 9, 6 / 9, 1])


@pytest.mark.parametrize("size", [(5, 7), (1, 1), (1, 6), (2, 2)])
def test_meta_kernel_is_the_naive_one(size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(3)
    kernel = MetaKernel(4).double()
    for parameter in kernel.parameters():
        nn.init.normal_(parameter, generator=generator)
    x = torch.randn(2, 5, *size, dtype=torch.float64, generator=generator)
    features = torch.randn(2, 4, *size, dtype=torch.float64, generator=generator)
    with torch.no_grad():
        out = kernel(x, features)
        for i in range(2):
            expected = reference.meta_kernel(kernel.state_dict(), x[i], features[i])
            torch.testing.assert_close(out[i], expected, rtol=1e-12, atol=1e-12)


def test_meta_kernel_gradient() -> None:
    generator = torch.Generator().manual_seed(4)
    kernel = MetaKernel(2, hidden=3).double()
    inputs = [torch.randn(1, c, 3, 4, dtype=torch.float64, generator=generator).requires_grad_() for c in (5, 2)]
    assert torch.autograd.gradcheck(kernel, inputs)


def test_attention_is_the_papers() -> None:
    generator = torch.Generator().manual_seed(5)
    attention = MotionGuidedAttention(6)
    spatial, channel_wise = attention.spatial, attention.channel_wise
    a, m = torch.randn(2, 3, 6, 4, 8, generator=generator)
    with torch.no_grad():
        out = attention(a, m)
        biases = (spatial.bias, channel_wise.bias)
        for i in range(3):
            expected = reference.attention(
                a[i], m[i], spatial.weight.flatten(1), channel_wise.weight.flatten(1), biases
            )
            torch.testing.assert_close(out[i], expected)


def test_skip_is_taken_before_dropout_and_pooling() -> None:
    block = ResBlock(4, 6, "soft", dropout=1.0)  # drops everything that it may drop
    pooled, skip = block(torch.randn(2, 4, 8, 8, generator=torch.Generator().manual_seed(6)))
    assert pooled.shape == (2, 6, 4, 4)
    assert skip.shape == (2, 6, 8, 8)
    assert not pooled.any()
    assert skip.all()


def test_up_block_doubles_the_resolution() -> None:
    out = UpBlock(8, 4)(torch.zeros(2, 8, 4, 6), torch.zeros(2, 8, 8, 12))
    assert out.shape == (2, 4, 8, 12)

"""What becomes integers, and their scales."""

import numpy as np
import pytest

from export.int8.integers import LARGEST, Params, kernel_integers


@pytest.mark.parametrize(("low", "high"), [(0, 5), (-3, 5), (-7, 0), (2, 6), (0, 0)])
def test_zero_is_met_exactly_and_values_within_half_a_step(low, high):
    params = Params.of(low, high)
    assert 0 <= params.zero <= 255
    assert params.to_integers(np.zeros(1))[0] == params.zero
    values = np.linspace(low, high, 1000)
    back = (params.to_integers(values).astype(float) - params.zero) * params.scale
    np.testing.assert_allclose(back, values, atol=params.scale * 0.501 + 1e-5, rtol=0)


def test_kernels_have_seven_bits_and_a_scale_for_each_output():
    kernel = np.random.default_rng(0).normal(size=(6, 3, 3, 3)) * np.logspace(-3, 3, 6)[:, None, None, None]
    kernel[2] = 0
    integers, scale = kernel_integers(kernel)
    assert integers.dtype == np.int8
    assert np.abs(integers).max() == LARGEST
    back = integers * scale[:, None, None, None]
    assert (np.abs(back - kernel).reshape(6, -1).max(1) <= scale * 0.501).all()
    assert 2 * 255 * LARGEST < 2**15  # two products in the 16-bit sum of processors without VNNI


def test_first_last_and_meta_kernel_geometry_stay_in_float(prepared):
    assert "logits" not in prepared.layers
    assert "context.0.shortcut" not in prepared.layers
    assert not any("near" in layer for layer in prepared.layers)
    assert {"context.0.first.conv", "meta_kernel.weigh2", "meta_kernel.joined"} <= set(prepared.layers)
    assert "decoder.3.join.conv" in prepared.layers
    assert len(prepared.layers["meta_kernel.joined"]) == 2
    assert len(prepared.layers["meta_kernel.weigh2"]) == 8

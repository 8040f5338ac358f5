"""Weights of the point head as a bundle holds them."""

import subprocess
import sys

import numpy as np
import pytest

from export.bundle.head_weights import fold
from runtime.bundle.head_shape import PointHeadConfig
from runtime.errors import CheckpointError
from runtime.head.weights import layers
from tests.support import reference_voxels as reference

SMALL = PointHeadConfig(in_channels=5, down=(6, 20), up=(17, 9), fuse_after_up=None)


def test_fold_names_what_is_wrong() -> None:
    weights = reference.random_weights(SMALL)
    del weights["stem.kernel"]
    weights["up1.0.norm.bias"] = np.zeros(3, np.float32)
    weights["more"] = np.zeros(3, np.float32)
    with pytest.raises(CheckpointError) as error:
        fold(weights, SMALL)
    for text in ("stem.kernel is missing", "up1.0.norm.bias is (3,), not (17,)", "more is unknown"):
        assert text in str(error.value)


def test_a_folded_layer_is_the_layer_and_its_norm() -> None:
    weights = reference.random_weights(SMALL, 4)
    folded = fold(weights, SMALL)
    head = reference.Head(weights, SMALL)
    for layer in layers(SMALL):
        if layer.offsets == 27:
            row = np.random.default_rng(0).normal(size=sum(layer.inputs))
            want = head.norm({0: row @ weights[f"{layer.name}.kernel"][5].astype(float)}, f"{layer.name}.norm")[0]
            bias = folded[f"{layer.name}.bias"]
            if f"{layer.name.replace('conv2', 'shortcut')}.kernel" in weights and layer.name.endswith("conv2"):
                continue  # whose bias holds that of the shortcut
            np.testing.assert_allclose(row @ folded[f"{layer.name}.weight"][5] + bias, want, rtol=1e-5, atol=1e-5)


def test_no_torch_is_needed() -> None:
    code = "import sys, export.bundle.head_weights, export.checkpoint.key_map; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

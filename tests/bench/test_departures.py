"""Every variant of "rt" runs, and is another network than the one that ships."""

import pytest
import torch

from bench.departures import CHANNELS, VARIANTS, build


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_classifies_every_pixel(name):
    network, (_, channels, _, _) = build(*VARIANTS[name])
    with torch.inference_mode():
        out = network(torch.randn(1, channels, 16, 32))
    assert out.logits.shape == (1, 3, 16, 32)
    assert out.features.shape[1] == CHANNELS


def test_variants_differ():
    image = torch.randn(1, 13, 16, 32, generator=torch.Generator().manual_seed(1))
    with torch.inference_mode():
        outs = {name: build(*variant)[0](image).logits for name, variant in VARIANTS.items()}
    base = outs.pop("rt")
    assert torch.equal(base, build(*VARIANTS["rt"])[0](image).logits)
    assert not any(torch.equal(base, out) for out in outs.values())

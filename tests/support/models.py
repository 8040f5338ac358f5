"""Networks with random weights for the tests of the export."""

import torch
from torch import nn


def randomise(module: nn.Module, seed: int = 0) -> nn.Module:
    """Random statistics, scales (some negative) and shifts in every BatchNorm; evaluation mode."""
    generator = torch.Generator().manual_seed(seed)
    for part in module.modules():
        if isinstance(part, nn.modules.batchnorm._BatchNorm):
            count = part.num_features
            part.running_mean.copy_(torch.randn(count, generator=generator) * 0.1)
            part.running_var.copy_(torch.rand(count, generator=generator) + 0.5)
            part.weight.data.copy_(torch.randn(count, generator=generator) * 0.3 + 0.8)
            part.bias.data.copy_(torch.randn(count, generator=generator) * 0.1)
    return module.eval()

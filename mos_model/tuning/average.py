"""The mean of two checkpoints.

Where the one was trained on from the other, the mean of their weights is often better than both on what either knows
(Wortsman et al., *Robust fine-tuning of zero-shot models*, CVPR 2022).
"""

from pathlib import Path

import torch
from torch import nn

from mos_model.networks.checkpoint import load, save
from mos_model.networks.config import differences
from runtime.errors import CheckpointError


def write_mean(new: Path, old: Path, out: Path) -> None:
    """Write a checkpoint with the mean of the weights of two; the rest of what `new` holds is kept, but for resuming.

    Raises CheckpointError where the two have not the same layers.
    """
    found, other = load(new), load(old)
    if lines := differences(other.config, found.config, ignored=("name",)):
        raise CheckpointError(f"{old}: has no mean with {new}: {'; '.join(lines)}")
    _to_the_middle(found.image_net, other.image_net)
    if found.point_head is not None and other.point_head is not None:
        _to_the_middle(found.point_head, other.point_head)
    training = {name: value for name, value in found.training.items() if name != "resume"}
    save(out, found.config, found.image_net, found.point_head, training)


def _to_the_middle(module: nn.Module, other: nn.Module) -> None:
    there = other.state_dict()
    with torch.no_grad():
        for name, value in module.state_dict().items():
            if value.is_floating_point():
                value.lerp_(there[name], 0.5)

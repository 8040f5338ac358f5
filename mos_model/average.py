"""The mean of two checkpoints: `python -m mos_model.average NEW.pt OLD.pt OUT.pt`.

Where the one was trained on from the other, the mean of their weights is often better than both on what either knows
(Wortsman et al., *Robust fine-tuning of zero-shot models*, CVPR 2022).
"""

import sys
from pathlib import Path
from typing import Annotated

import torch
import typer
from torch import nn

from mos_model.networks.checkpoint import load, save
from mos_model.networks.config import differences
from runtime.commands.handler import run_alone
from runtime.commands.output import show_line
from runtime.errors import CheckpointError


def move_towards(module: nn.Module, other: nn.Module, share: float) -> None:
    """Move the weights of `module` by `share` of the way to those of `other`, which has the same layers."""
    there = other.state_dict()
    with torch.no_grad():
        for name, value in module.state_dict().items():
            if value.is_floating_point():
                value.lerp_(there[name], share)


def average(
    new: Annotated[Path, typer.Argument(help="Checkpoint that was trained on; the rest of what it holds is kept")],
    old: Annotated[Path, typer.Argument(help="Checkpoint that it was trained from")],
    out: Annotated[Path, typer.Argument(help="Checkpoint of the mean")],
    share: Annotated[float, typer.Option(min=0, max=1, help="Of the old weights in the mean")] = 0.5,
) -> None:
    """Write the mean of the weights of two checkpoints."""
    found, other = load(new), load(old)
    if lines := differences(other.config, found.config, ignored=("name",)):
        raise CheckpointError(f"{old}: has no mean with {new}: {'; '.join(lines)}")
    move_towards(found.image_net, other.image_net, share)
    if found.point_head is not None and other.point_head is not None:
        move_towards(found.point_head, other.point_head, share)
    training = {name: value for name, value in found.training.items() if name != "resume"}
    out.parent.mkdir(parents=True, exist_ok=True)
    save(out, found.config, found.image_net, found.point_head, training)
    show_line(f"{out}: {share:g} of {old}, the rest of {new}")


if __name__ == "__main__":
    sys.exit(run_alone(average, "average"))

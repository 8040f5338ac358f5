"""What each departure of "rt" from the published design is worth in time: `python -m bench.departures`.

Each row is "rt" with one departure undone, random weights, as the runtime runs it.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from torch import Tensor, nn

from bench.report import interleaved, save, show, summary
from export.graph.image_graph import image_bytes
from mos_model.networks.blocks import act
from mos_model.networks.image_output import ImageOutput
from mos_model.networks.rt import RealtimeConfig, RealtimeNet, Up, conv
from runtime.classes import CLASSES
from runtime.commands.handler import run_alone
from runtime.image.image_net import ImageNet

CHANNELS = 16


class LeakyFirst(nn.Module):
    """Convolution, LeakyReLU, BatchNorm: the published order."""

    def __init__(self, block: nn.Sequential) -> None:
        super().__init__()
        self.conv, self.norm = block[0], block[1]

    def forward(self, x: Tensor) -> Tensor:
        return self.norm(act(self.conv(x)))


class ShuffledUp(nn.Module):
    """Twice the resolution by a pixel shuffle, joined with the skip by addition."""

    def __init__(self, up: Up) -> None:
        super().__init__()
        out, inputs = up.reduce.weight.shape[:2]
        self.reduce, self.conv = nn.Conv2d(inputs, 4 * out, 1), up.conv

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        return self.conv(torch.relu(nn.functional.pixel_shuffle(self.reduce(x), 2) + skip))


class ConcatenatedUp(nn.Module):
    """Twice the resolution by nearest neighbours, the skip concatenated."""

    def __init__(self, up: Up) -> None:
        super().__init__()
        out = up.reduce.weight.shape[0]
        self.reduce, self.conv = up.reduce, conv(2 * out, out)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        up = nn.functional.interpolate(self.reduce(x), scale_factor=2.0, mode="nearest")
        return self.conv(torch.cat((up, skip), dim=1))


class FullWidth(RealtimeNet):
    """Stems that keep the width of the image."""

    def forward(self, image: Tensor) -> ImageOutput:
        x = torch.relu(self.features(self.decode(image)))
        return ImageOutput(self.logits(x), x)


def full_width(network: RealtimeNet) -> None:
    network.__class__ = FullWidth
    for stem in (network.range_stem, network.motion_stem):
        stem[0].stride = (1, 1)
    network.logits = nn.Conv2d(CHANNELS, len(CLASSES), 1)


def pooled(network: RealtimeNet) -> None:
    for stages in (network.range_down, network.motion_down):
        for i, stage in enumerate(stages):
            stage[0].stride = (1, 1)
            stages[i] = nn.Sequential(stage, nn.AvgPool2d(3, 2, 1))


def leaky_first(network: RealtimeNet) -> None:
    for module in list(network.modules()):
        for name, child in module.named_children():
            if isinstance(child, nn.Sequential) and isinstance(child[-1], nn.ReLU):
                setattr(module, name, LeakyFirst(child))


def shuffled(network: RealtimeNet) -> None:
    network.up = nn.ModuleList(map(ShuffledUp, network.up))


def concatenated(network: RealtimeNet) -> None:
    network.up = nn.ModuleList(map(ConcatenatedUp, network.up))


def untouched(network: RealtimeNet) -> None:
    pass


VARIANTS: dict[str, tuple[int, Callable[[RealtimeNet], None]]] = {  # factor of the widths, change
    "rt": (1, untouched),
    "LeakyReLU before BatchNorm": (1, leaky_first),
    "average pooling after full-size convolutions": (1, pooled),
    "stems that keep the width": (1, full_width),
    "pixel shuffles on the way up": (1, shuffled),
    "concatenated skips": (1, concatenated),
    "twice the widths": (2, untouched),
}


def build(factor: int, change: Callable[[RealtimeNet], None]) -> tuple[nn.Module, tuple[int, ...]]:
    """A variant, and the shape of its image."""
    torch.manual_seed(0)
    config = RealtimeConfig(channels=CHANNELS, widths=tuple(factor * width for width in RealtimeConfig.widths))
    network = RealtimeNet(config)
    change(network)
    return network.eval(), (1, *config.view.shape)


def bench(
    threads: int = 2,
    rounds: int = 21,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Median time of the image network with each departure undone, all of them in turn."""
    nets, rows = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for i, (name, variant) in enumerate(VARIANTS.items()):
            network, shape = build(*variant)
            path = Path(folder) / f"{i}.onnx"
            path.write_bytes(image_bytes(network, shape))
            nets[name] = ImageNet(path, threads=threads)
    image = np.random.default_rng(0).normal(0, 0.5, shape[1:]).astype(np.float32)
    tasks = {name: (lambda net=net: net.run(image)) for name, net in nets.items()}
    for name, seconds in interleaved(tasks, rounds).items():
        rows[name] = summary(seconds)
        rows[name]["times rt"] = round(rows[name]["median"] / rows["rt"]["median"], 2)
    show(f"image network with one departure undone, {threads} threads, ms", rows)
    save(out, threads, {"ms": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "departures"))

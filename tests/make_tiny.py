"""Make the tiny checkpoint and bundle that tests use: `python -m tests.make_tiny [FOLDER]`.

A v2-lite with 4 channels and a small head for 64 x 256 pixels, with random weights: it runs fast and finds nothing.
"""

import shutil
import sys
import tempfile
from pathlib import Path

import torch
from torch import nn

from export.to_onnx import export_checkpoint
from mos_model.checkpoint import save
from mos_model.config import ModelConfig, named_config
from mos_model.network import build_image_network, build_point_head
from runtime.head_config import PointHeadConfig
from runtime.sensor import Sensor

FOLDER = Path(__file__).parent / "data" / "tiny"
SEED = 0


def tiny_config() -> ModelConfig:
    """The smallest network that has every part."""
    head = PointHeadConfig(in_channels=4, down=(8, 16), up=(16, 8), fuse_after_up=None, dropout=0.0)
    return named_config("v2-lite", 4, name="tiny", sensor=Sensor(width=256), point_head=head)


def random_network(config: ModelConfig) -> tuple[nn.Module, nn.Module | None]:
    """Modules with random weights, BatchNorms with random statistics (so that a test can see their folding)."""
    torch.manual_seed(SEED)
    image_net, point_head = build_image_network(config), build_point_head(config)
    for part in (image_net, point_head):
        for module in part.modules() if part is not None else ():
            if isinstance(module, nn.modules.batchnorm._BatchNorm):
                nn.init.uniform_(module.weight, 0.8, 1.2)
                nn.init.normal_(module.bias, 0, 0.1)
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.8, 1.2)
    return image_net.eval(), point_head


def main(folder: Path = FOLDER) -> None:
    """Write `folder`/checkpoint.pt and `folder`/bundle."""
    folder.mkdir(parents=True, exist_ok=True)
    config = tiny_config()
    image_net, point_head = random_network(config)
    save(folder / "checkpoint.pt", config, image_net, point_head, {"trained": False}, half=True)
    with tempfile.TemporaryDirectory() as work:
        export_checkpoint(folder / "checkpoint.pt", Path(work) / "bundle")
        shutil.copytree(Path(work) / "bundle", folder / "bundle", dirs_exist_ok=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))

"""Make the tiny checkpoint, bundle and scans that tests use: `python -m tests.support.make_tiny [TINY]`.

A v2-lite with 4 channels and a small head for 64 x 256 pixels, with random weights: it runs fast and finds nothing.
Nine thinned simulated scans, and what PyTorch computes for the last of them from the naive network input.
"""

import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from export.convert import export_checkpoint
from mos_model.networks.checkpoint import load, save
from mos_model.networks.config import ModelConfig
from mos_model.networks.registry import named_config
from mos_model.simulator.write import write_dataset
from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.residual import HISTORY
from runtime.recordings.registry import open_recording
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import SENSORS
from tests.support.paths import TINY
from tests.support.reference_inputs import input_image, project_point

SEED = 0


def tiny_config() -> ModelConfig:
    """The smallest network that has every part."""
    head = PointHeadConfig(in_channels=4, down=(8, 16), up=(16, 8), fuse_after_up=None, dropout=0.0)
    return named_config("v2-lite", 4, name="tiny", range_image=RangeImage(width=256), point_head=head)


def random_network(config: ModelConfig) -> tuple[nn.Module, nn.Module | None]:
    """Modules with random weights, BatchNorms with random statistics (so that a test can see their folding)."""
    torch.manual_seed(SEED)
    image_net, point_head = config.build_image_network(), config.build_point_head()
    for part in (image_net, point_head):
        for module in part.modules() if part is not None else ():
            if isinstance(module, nn.modules.batchnorm._BatchNorm):
                nn.init.uniform_(module.weight, 0.8, 1.2)
                nn.init.normal_(module.bias, 0, 0.1)
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.8, 1.2)
    return image_net.eval(), point_head


def write_scans(folder: Path) -> None:
    """`folder`/sequences/00: a drive past a mover, with a seventh of the sensor's columns."""
    shutil.rmtree(folder, ignore_errors=True)
    write_dataset(
        folder, 1, HISTORY + 1, seed=5, sensor=replace(SENSORS["hdl64e"], azimuth_steps=150), origin_point=True
    )


def expected_probabilities(checkpoint: Path, sequence: Path) -> np.ndarray:
    """(N, 3) f32 of the last scan of `sequence`: naive input, then all in PyTorch; 0 for points without pixel."""
    found = load(checkpoint)
    config, head = found.config, found.point_head
    assert head is not None
    drive = [(scan.data, scan.known_pose()) for scan in open_recording(sequence).scans()]
    *past, (points, pose) = drive[: HISTORY + 1]
    past.reverse()
    relative = [np.linalg.inv(pose) @ other for _, other in past]
    image = input_image(points, [scan for scan, _ in past], relative, config.range_image, config.residual)
    pixels = np.array([project_point(*point[:3].astype(np.float64), config.range_image)[:2] for point in points])
    valid = pixels[:, 0] >= 0
    u, v = pixels[valid].T
    probabilities = np.zeros((len(points), 3), np.float32)
    with torch.no_grad():
        features = found.image_net(torch.from_numpy(image[None].astype(np.float32))).features[0]  # (c, H, W)
        grid = head.grid(torch.from_numpy(points[valid, :3].copy()))
        probabilities[valid] = head(grid, features[:, v, u].T).softmax(1).numpy()
    return probabilities


def main(folder: Path = TINY) -> None:
    """Write `folder`/checkpoint.pt, `folder`/bundle, `folder`/scans and `folder`/expected.npy."""
    folder.mkdir(parents=True, exist_ok=True)
    config = tiny_config()
    image_net, point_head = random_network(config)
    save(folder / "checkpoint.pt", config, image_net, point_head, {"trained": False, "licence": "MIT"}, half=True)
    with tempfile.TemporaryDirectory() as work:
        export_checkpoint(folder / "checkpoint.pt", Path(work) / "bundle", point_head_onnx=True)
        shutil.copytree(Path(work) / "bundle", folder / "bundle", dirs_exist_ok=True)
    write_scans(folder / "scans")
    np.save(folder / "expected.npy", expected_probabilities(folder / "checkpoint.pt", folder / "scans/sequences/00"))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))

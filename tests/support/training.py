"""What the tests of the training share: a tiny sensor, tiny networks, samples that cost nothing."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mos_model.data.dataset import Sample
from mos_model.networks.config import ModelConfig
from mos_model.networks.registry import named_config
from runtime.sensors.range_image import RangeImage
from tests.support import street

IMAGE = RangeImage(height=16, width=64, fov_up=16, fov_down=-16)


def tiny_model(name: str = "rt", channels: int = 4, range_image: RangeImage = IMAGE) -> ModelConfig:
    """A network that trains in no time."""
    changes = {"widths": (4, 8, 8)} if name == "rt" else {}
    return named_config(name, channels, range_image=range_image, **changes)


@dataclass(frozen=True)
class Patches:
    """Images in which what has a residual moves; a group is a function of the seed and its number."""

    seed: int = 0
    group_size: int = 4
    height: int = 16
    width: int = 64
    points: int = 0
    broken_from: int = 1 << 60  # groups from here on hold NaN

    def group(self, number: int) -> list[Sample]:
        """See `Source`."""
        rng = np.random.default_rng((self.seed, number))
        return [self._sample(rng, number) for _ in range(self.group_size)]

    def _sample(self, rng: np.random.Generator, number: int) -> Sample:
        labels = np.ones((self.height, self.width), np.uint8)
        labels[:2] = 0
        for _ in range(3):
            v, u = rng.integers(2, self.height - 4), rng.integers(self.width - 8)
            labels[v : v + 4, u : u + 8] = 2
        image = rng.normal(0, 0.3, (13, self.height, self.width)).astype(np.float32)
        image[5:, labels == 2] += 1
        if number >= self.broken_from:
            image[:] = np.nan
        pixel = rng.integers(0, labels.size, self.points).astype(np.int32)
        xyz = rng.uniform(-3, 3, (self.points, 3)).astype(np.float32)
        return Sample(image, labels, xyz, pixel, labels.reshape(-1)[pixel])


def write_recording(folder: Path, frames: int = 12, car: bool = True, seed: int = 0) -> None:
    """A sequence in the layout of SemanticKITTI: a street as IMAGE sees it, and a car that drives ahead of the sensor.

    The last point of each scan is at the origin, as in real files, and the last five have no label.
    """
    world, poses = street.boxes(seed), street.drive(frames)
    for name in ("velodyne", "labels"):
        (folder / name).mkdir(parents=True)
    for i, pose in enumerate(poses):
        front = pose[0, 3] + 6 + 0.3 * i
        box = np.array([[front, -1.5, 0.3], [front + 4, 0.5, 1.9]])
        scan = street.scan(pose, np.concatenate([world, box[None]]) if car else world, 16, 360, (15.0, -15.0))
        places = scan[:, :3] @ pose[:3, :3].T + pose[:3, 3]
        moving = car & ((places > box[0] - 0.01) & (places < box[1] + 0.01)).all(axis=1)
        labels = np.where(moving, 252, 40 | 7 << 16).astype(np.uint32)
        scan[-1, :3] = labels[-5:] = 0
        scan.tofile(folder / "velodyne" / f"{i:06d}.bin")
        labels.tofile(folder / "labels" / f"{i:06d}.label")
    street.write_camera_poses(folder, poses)

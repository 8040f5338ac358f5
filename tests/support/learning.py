"""What the tests of whole networks share: drives to learn from, a short training, a quick export, and odd scans."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from export.bundle import parity
from export.convert import Export, export_checkpoint
from mos_model.data.dataset import Frame, Sample, SampleConfig, make_samples
from mos_model.networks.checkpoint import load, save
from mos_model.networks.config import ModelConfig
from mos_model.simulator import simulate
from mos_model.training.distributed import Ranks
from mos_model.training.progress import Display
from mos_model.training.recipe import recipe
from mos_model.training.tasks import ImageTask
from mos_model.training.trainer import Limits, Trainer
from runtime.classes import MOVING, STATIC
from runtime.evaluation.confusion import Confusion
from runtime.runner import MosRunner
from runtime.sensors.registry import SENSORS


def drive(count: int, seed: int = 0) -> list[Frame]:
    """Still boxes and one that moves by a metre a scan, seen from a sensor that moves too."""
    rng = np.random.default_rng(seed)
    still = rng.uniform((-14, -14, -1), (14, 14, 1), (300, 3)).repeat(4, 0)
    start, step = rng.uniform(-6, 6, 2), rng.choice([-1.0, 1.0])
    frames = []
    for t in range(count):
        pose = np.eye(4)
        pose[0, 3] = 0.5 * t
        box = rng.uniform(-1, 1, (300, 3))
        box[:, :2] += start + np.array((0.5, step)) * t
        near = still + rng.normal(0, 0.01, still.shape)
        points = np.concatenate([near, box]) - pose[:3, 3]
        remission = np.full((len(points), 1), 0.3)
        classes = np.repeat(np.array([1, 2], np.uint8), (len(still), len(box)))
        frames.append(Frame(np.concatenate([points, remission], 1).astype(np.float32), pose, classes))
    return frames


@dataclass(frozen=True)
class Drives:
    """A sample of each of some drives."""

    samples: SampleConfig
    lost: int = 0  # points that the last scan of every second drive lacks
    group_size: int = 4

    def group(self, number: int) -> list[Sample]:
        """See `Source`."""
        return [self._sample(seed) for seed in range(4 * number, 4 * number + 4)]

    def _sample(self, seed: int) -> Sample:
        before, last = drive(2, seed)
        rest = len(last.points) - self.lost * (seed % 2)
        last = Frame(last.points[:rest], last.pose, last.classes[:rest])
        return make_samples([before, last], self.samples, np.random.default_rng(seed))[0]


def train(config: ModelConfig, folder: Path, lost: int = 0, **changes: Any) -> Path:
    """A checkpoint whose image network was trained; its point head is random. changes: of the recipe."""
    steps = recipe("sim2real", **{"batch": 4, "crop": 0, "mix": 1, "warmup": 5, "ema": 0.9, **changes})
    torch.manual_seed(0)
    task = ImageTask(config, torch.tensor([0.0, 1.0, 3.0]), torch.device("cpu"))
    source = Drives(SampleConfig.of(config), lost)
    trainer = Trainer(task, steps, source, None, folder, ranks=Ranks(torch.device("cpu")), workers=0)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # more would wait for each other
    with Display(folder, quiet=True) as display:
        trainer.run(Limits(), display)
    torch.set_num_threads(threads)
    found = load(folder / "last.pt")
    assert found.config == replace(config, point_head=None)
    save(folder / "checkpoint.pt", config, found.image_net, config.build_point_head(), {"trained": True})
    return folder / "checkpoint.pt"


def export_quickly(checkpoint: Path) -> Export:
    """Its bundle. The gate's scan has a tenth of the sensor's columns."""
    thin = replace(SENSORS["hdl64e"], azimuth_steps=200)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parity, "simulate", lambda seed, frames, _, **more: simulate(seed, frames, thin, **more))
        return export_checkpoint(checkpoint, checkpoint.parent / "bundle")


def iou_of_new_drives(bundle: Path) -> float:
    """Of the mover of drives that no training saw; the first scan has no past to tell it from."""
    found = Confusion()
    with MosRunner(bundle, threads=1, postprocess="none") as runner:
        for seed in range(1000, 1006):
            runner.reset()
            frames = drive(3, seed)
            *_, last = (runner(frame.points, frame.pose).moving for frame in frames)
            found.add(frames[-1].classes, np.where(last, MOVING, STATIC))
    return found.iou


def check_odd_scans(bundle: Path, postprocess: str) -> None:
    """Empty, one point, all in one cell, all out of the view, and as the first of a sequence or not."""
    ordinary = drive(1)[0].points
    crowd = np.tile(ordinary[:1], (5000, 1))
    far = ordinary + np.float32([100, 0, 0, 0])
    high = ordinary + np.float32([0, 0, 40, 0])
    with MosRunner(bundle, threads=2, postprocess=postprocess, refine="all") as runner:
        for first in (False, True):
            for points in (ordinary[:0], ordinary[:1], crowd, far, high, ordinary):
                if first:
                    runner.reset()
                result = runner(points, np.eye(4))
                assert result.moving.shape == result.probability.shape == (len(points),)
                assert ((result.probability >= 0) & (result.probability <= 1)).all()
                if points is far or points is high:
                    assert not result.moving.any()
                    assert not result.probability.any()

"""LiMoSeg from training to labels: it learns what has moved, its bundle runs, and odd scans are no trouble."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from export.bundle import parity
from export.convert import Export, export_checkpoint
from mos_model.data.dataset import Frame, Sample, SampleConfig, make_samples
from mos_model.networks.checkpoint import load, save
from mos_model.networks.registry import named_config
from mos_model.simulator import simulate
from mos_model.training.distributed import Ranks
from mos_model.training.progress import Display
from mos_model.training.recipe import recipe
from mos_model.training.tasks import ImageTask
from mos_model.training.trainer import Limits, Trainer
from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.view import BirdView
from runtime.classes import MOVING, STATIC
from runtime.errors import SettingError
from runtime.evaluation.confusion import Confusion
from runtime.runner import MosRunner
from runtime.sensors.registry import SENSORS

BIRD = BirdView(cells=64, cell_size=0.5)
HEAD = PointHeadConfig(in_channels=4, down=(8, 16), up=(16, 8), fuse_after_up=None, dropout=0.0, voxel_size=0.5)
CONFIG = named_config("limoseg", 4, bird=BIRD, widths=(8, 16), point_head=HEAD)


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
    group_size: int = 4

    def group(self, number: int) -> list[Sample]:
        """See `Source`."""
        seeds = range(4 * number, 4 * number + 4)
        return [make_samples(drive(2, seed), self.samples, np.random.default_rng(seed))[0] for seed in seeds]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint whose image network was trained; its point head is random."""
    folder = tmp_path_factory.mktemp("limoseg")
    steps = recipe("sim2real", steps=150, batch=4, crop=0, mix=1, warmup=5, ema=0.9)
    torch.manual_seed(0)
    task = ImageTask(CONFIG, torch.tensor([0.0, 1.0, 3.0]), torch.device("cpu"))
    source = Drives(SampleConfig.of(CONFIG))
    trainer = Trainer(task, steps, source, None, folder, ranks=Ranks(torch.device("cpu")), workers=0)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # more would wait for each other
    with Display(folder, quiet=True) as display:
        trainer.run(Limits(), display)
    torch.set_num_threads(threads)
    found = load(folder / "last.pt")
    assert found.config == replace(CONFIG, point_head=None)
    save(folder / "checkpoint.pt", CONFIG, found.image_net, CONFIG.build_point_head(), {"trained": True})
    return folder / "checkpoint.pt"


@pytest.fixture(scope="module")
def exported(trained: Path) -> Export:
    """Its bundle. The gate's scan has a tenth of the sensor's columns, to be quick."""
    thin = replace(SENSORS["hdl64e"], azimuth_steps=200)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parity, "simulate", lambda seed, frames, _, **more: simulate(seed, frames, thin, **more))
        return export_checkpoint(trained, trained.parent / "bundle")


def test_it_learns_what_has_moved(exported: Export) -> None:
    """The mover of drives that it has not seen, by the runner; the first scan has no past to tell it from."""
    found = Confusion()
    with MosRunner(exported.bundle.path, threads=1, postprocess="none") as runner:
        for seed in range(1000, 1006):
            runner.reset()
            frames = drive(3, seed)
            *_, last = (runner(frame.points, frame.pose).moving for frame in frames)
            found.add(frames[-1].classes, np.where(last, MOVING, STATIC))
    assert found.iou > 0.5


def test_the_bundle_is_the_network(exported: Export) -> None:
    manifest = exported.bundle.manifest
    assert (manifest.network, manifest.bird) == ("limoseg", BIRD)
    assert exported.parity.worst() < 1e-5
    assert exported.parity.point_head is not None


@pytest.mark.parametrize("postprocess", ["none", "knn", "head"])
def test_odd_scans(exported: Export, postprocess: str) -> None:
    """Empty, one point, all in one cell, all out of the view, and as the first of a sequence or not."""
    ordinary = drive(1)[0].points
    crowd = np.tile(ordinary[:1], (5000, 1))
    far = ordinary + np.float32([100, 0, 0, 0])
    high = ordinary + np.float32([0, 0, 40, 0])
    with MosRunner(exported.bundle.path, threads=2, postprocess=postprocess, refine="all") as runner:
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


def test_two_past_scans_have_an_encoder_each() -> None:
    residual = replace(CONFIG.residual, lags=(1, 3))
    config = replace(CONFIG, residual=residual)
    network = config.build_image_network().eval()
    images = [torch.zeros(1, *config.view.shape) for _ in range(2)]
    images[1][:, 9:] = 1
    assert config.in_channels == 13
    with torch.no_grad():
        assert not torch.equal(*(network(image).logits for image in images))


def test_widths_that_cannot_be() -> None:
    for widths in ((), (8, 0), (8,) * 5):
        with pytest.raises(SettingError, match="widths"):
            named_config("limoseg", 4, widths=widths)

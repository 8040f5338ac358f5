"""LiMoSeg from training to labels: it learns what has moved, its bundle runs, and odd scans are no trouble."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from export.convert import Export
from mos_model.networks.registry import named_config
from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.view import BirdView
from runtime.errors import SettingError
from tests.support.learning import check_odd_scans, export_quickly, iou_of_new_drives, train

BIRD = BirdView(cells=64, cell_size=0.5)
HEAD = PointHeadConfig(in_channels=4, down=(8, 16), up=(16, 8), fuse_after_up=None, dropout=0.0, voxel_size=0.5)
CONFIG = named_config("limoseg", 4, bird=BIRD, widths=(8, 16), point_head=HEAD)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(CONFIG, tmp_path_factory.mktemp("limoseg"), steps=150)


@pytest.fixture(scope="module")
def exported(trained: Path) -> Export:
    return export_quickly(trained)


def test_it_learns_what_has_moved(exported: Export) -> None:
    assert iou_of_new_drives(exported.bundle.path) > 0.5


def test_the_bundle_is_the_network(exported: Export) -> None:
    manifest = exported.bundle.manifest
    assert (manifest.network, manifest.bird) == ("limoseg", BIRD)
    assert exported.parity.worst() < 1e-5
    assert exported.parity.point_head is not None
    assert (replace(CONFIG, point_head=None).postprocess, CONFIG.postprocess) == ("none", "head")


@pytest.mark.parametrize("postprocess", ["none", "knn", "head"])
def test_odd_scans(exported: Export, postprocess: str) -> None:
    check_odd_scans(exported.bundle.path, postprocess)


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

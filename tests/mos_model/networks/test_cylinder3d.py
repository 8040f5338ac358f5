"""Cylinder3D from training to labels: it learns what has moved, its bundle runs, and odd scans are no trouble."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from bench.accuracy import systems_of
from export.bundle.cylinder_weights import cylinder_arrays
from export.convert import Export, export_checkpoint
from mos_model.data.dataset import Frame, SampleConfig, make_samples
from mos_model.networks.registry import named_config
from mos_model.networks.sparse import SparseConv
from mos_model.training.tasks import ImageTask
from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.loading import load_bundle
from runtime.bundle.manifest import CYLINDER_NET, MANIFEST
from runtime.bundle.view import CylinderView
from runtime.classes import MOVING
from runtime.commands.main import main
from runtime.compute.workers import Workers
from runtime.errors import BundleError, InferenceError, MosWarning, ProviderError, SettingError
from runtime.head.cylinder.cylinder_net import CylinderNet
from runtime.runner import MosRunner
from tests.support.learning import check_odd_scans, drive, export_quickly, iou_of_new_drives, train

CYLINDER = CylinderView(rings=32, sectors=48, layers=8, radius=20.0, bottom=-2.0, top=2.0)
HEAD = PointHeadConfig(in_channels=4, down=(8, 16), up=(16, 8), fuse_after_up=None, dropout=0.0, voxel_size=0.5)
CONFIG = named_config("cylinder3d", 4, cylinder=CYLINDER, point_head=HEAD)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of lists of points of unequal lengths."""
    return train(CONFIG, tmp_path_factory.mktemp("cylinder3d"), lost=50, steps=100, precision="fp32")


@pytest.fixture(scope="module")
def exported(trained: Path) -> Export:
    return export_quickly(trained)


def test_it_learns_what_has_moved(exported: Export) -> None:
    assert iou_of_new_drives(exported.bundle.path) > 0.5


def test_the_bundle_is_the_network(exported: Export) -> None:
    manifest = exported.bundle.manifest
    assert (manifest.network, manifest.cylinder, manifest.postprocess) == ("cylinder3d", CYLINDER, "head")
    assert exported.parity.worst() < 1e-5
    assert exported.parity.point_head is not None
    systems = systems_of([exported.bundle], threads=1, precision="auto")
    assert [*systems][1:] == ["bundle, none", "bundle, head"]  # points do not vote


def test_any_weights_give_what_pytorch_gives() -> None:
    """BatchNorms too that are none of a new network; widths that fill no whole panel; two past scans; any threads."""
    config = replace(CONFIG, channels=10, point_head=None, residual=replace(CONFIG.residual, lags=(1, 2)))
    torch.manual_seed(1)
    network = config.build_image_network().eval()
    for layer in network.modules():
        if isinstance(layer, nn.BatchNorm1d):
            nn.init.normal_(layer.weight, 1, 0.5)
            for values in (layer.bias, layer.running_mean):
                nn.init.normal_(values, 0, 0.3)
            nn.init.uniform_(layer.running_var, 0.3, 1)
        elif isinstance(layer, SparseConv):
            layer.kernel.data *= 2  # few of its pairs are there
    samples = SampleConfig.of(config)
    image = make_samples(drive(3), samples, np.random.default_rng(0))[0].image
    with torch.no_grad():
        want = network(torch.from_numpy(image[None]))
    arrays = cylinder_arrays(network, 10, half=False)
    net, other = (CylinderNet(arrays, CYLINDER, 10, Workers(threads)) for threads in (1, 3))
    for same in (other.run(image), other.run(image)):  # buffers are used again
        seen = net.run(image)
        np.testing.assert_array_equal(seen.probabilities, same.probabilities)
        np.testing.assert_array_equal(seen.features, same.features)
        np.testing.assert_allclose(seen.probabilities, want.logits.softmax(1)[0].numpy(), atol=1e-5)
        assert seen.probabilities[MOVING].std() > 0.01
        scale = float(want.features.abs().max())
        np.testing.assert_allclose(seen.features / scale, want.features[0].numpy() / scale, atol=1e-5)
    assert net.multiply_adds > 0


@pytest.mark.parametrize("postprocess", ["none", "head"])
def test_odd_scans(exported: Export, postprocess: str) -> None:
    check_odd_scans(exported.bundle.path, postprocess)


def test_training_on_odd_scans_and_crops() -> None:
    """Empty lists, one point, and points of some sectors; a loss and gradients that are finite."""
    samples = SampleConfig.of(CONFIG, crop=16, crop_on_moving=1.0, points=True)
    rng = np.random.default_rng(0)
    (crop,) = make_samples(drive(2), samples, rng)
    sectors = crop.image[10, 0].astype(int) // CYLINDER.layers % CYLINDER.sectors
    assert len(np.unique(sectors)) <= 16
    assert (crop.labels == MOVING).any()
    np.testing.assert_array_equal(crop.labels[0, crop.pixel], crop.classes)
    ordinary, *_ = drive(1)
    few = [Frame(ordinary.points[:n], ordinary.pose, ordinary.classes[:n]) for n in (0, 1)]
    batch = [crop, *(make_samples([frame], SampleConfig.of(CONFIG), rng)[0] for frame in few)]
    task = ImageTask(CONFIG, torch.tensor([0.0, 1.0, 3.0]), torch.device("cpu"))
    for some in (batch, batch[1:2]):
        loss = task.score(task.trained.train(), some).loss.total
        loss.backward()
        assert torch.isfinite(loss)


def test_what_it_cannot_do_is_said(exported: Export, trained: Path) -> None:
    path = exported.bundle.path
    with pytest.raises(SettingError, match="points, not pixels"):
        MosRunner(path, threads=1, postprocess="knn")
    with pytest.raises(BundleError, match="int8"):
        MosRunner(path, threads=1, precision="int8")
    with pytest.raises(ProviderError, match="runs on the processor"):
        MosRunner(path, threads=1, providers=["CUDAExecutionProvider"])
    with pytest.warns(MosWarning, match="runs on the processor"):
        MosRunner(path, threads=1, providers=["CUDAExecutionProvider"], allow_fallback=True)
    with pytest.raises(SettingError, match="8-bit integers"):
        export_checkpoint(trained, trained.parent / "other", precision="int8")
    assert not (trained.parent / "other").exists()
    net = CylinderNet(exported.bundle.cylinder_net(), CYLINDER, 4, Workers(1))
    with pytest.raises(InferenceError, match="takes"):
        net.run(np.zeros((9, 1, 5), np.float32))


def test_info_runs_it_once(exported: Export, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "--verify", str(exported.bundle.path)]) == 0
    assert "points in a cylinder" in capfd.readouterr().out


CHANGES = {
    "no cylinder": {"cylinder": None},
    "too large": {"cylinder": {"rings": 1 << 20, "sectors": 1 << 20}},
    "no number": {"cylinder": {"radius": "50"}},
    "from above too": {"bird": {}},
    "no features": {"features": 0, "point_head": None},
    "features without end": {"features": 1 << 40},
    "a vote": {"postprocess": "knn"},
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_manifests_of_strangers(exported: Export, tmp_path: Path, change: dict[str, object]) -> None:
    bundle = shutil.copytree(exported.bundle.path, tmp_path / "bundle")
    values = json.loads((bundle / MANIFEST).read_text())
    (bundle / MANIFEST).write_text(json.dumps({**values, **change}))
    with pytest.raises(BundleError, match=MANIFEST):
        load_bundle(bundle)


def test_weights_of_strangers(exported: Export) -> None:
    """Missing, misshapen, not finite, or of another width."""
    weights = exported.bundle.cylinder_net()
    name = "down2.pool.weight"
    spoilt = {
        "is missing": {key: value for key, value in weights.items() if key != name},
        "not floats of shape": {**weights, name: weights[name][:, :3]},
        "is not finite": {**weights, name: np.full_like(weights[name], np.nan)},
        "is unknown": {**weights, "more": weights[name]},
    }
    for text, values in spoilt.items():
        with pytest.raises(BundleError, match=text):
            CylinderNet(values, CYLINDER, 4, Workers(1))
    with pytest.raises(BundleError, match="8 channels"):
        CylinderNet(weights, CYLINDER, 8, Workers(1))
    assert CYLINDER_NET in exported.bundle.manifest.files

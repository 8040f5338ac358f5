from dataclasses import replace

import pytest
import torch
from torch import nn

from mos_model.networks.point_head import PointHead, RowNorm
from runtime.bundle.head_shape import FULL, LITE, PointHeadConfig
from runtime.errors import ScanError
from tests.mos_model.networks.test_voxels import cloud
from tests.support import published

SMALL = PointHeadConfig(in_channels=4, down=(4, 6, 8), up=(8, 6, 5), fuse_after_up=1, dropout=0.3)


def small_head(**changes: object) -> PointHead:
    torch.manual_seed(1)
    return PointHead(replace(SMALL, **changes)).eval()


def features_of(count: int, channels: int = 4) -> torch.Tensor:
    return torch.randn(count, channels, generator=torch.Generator().manual_seed(count))


@pytest.mark.parametrize(("config", "count"), [(FULL, 21_772_931), (LITE, 4_475_203)])
def test_as_large_as_published(config: PointHeadConfig, count: int) -> None:
    with torch.device("meta"):
        head = PointHead(config)
    assert sum(parameter.numel() for parameter in head.parameters()) == count


@pytest.mark.parametrize("kind", ["full", "lite"])
def test_same_numbers_as_the_published_heads(kind: str) -> None:
    head = published.reference_head(kind)
    expected = published.reference_output(f"point_head_{kind}")
    with torch.no_grad():
        logits = head(head.grid(expected["xyz"]), expected["point_features"])
    torch.testing.assert_close(logits.softmax(1), expected["probabilities"], rtol=0, atol=1e-5)


@pytest.mark.parametrize("changes", [{}, {"fuse_after_up": None}, {"reduce": "mean"}, {"down": (4,), "up": (6,)}])
def test_every_parameter_learns(changes: dict) -> None:
    if "down" in changes:
        changes = changes | {"fuse_after_up": None}
    head = small_head(**changes).train()
    xyz = cloud(400, extent=1.0)
    loss = nn.functional.cross_entropy(head(head.grid(xyz), features_of(400)), torch.arange(400) % 3)
    loss.backward()
    for key, parameter in head.named_parameters():
        assert parameter.grad is not None, key
        assert parameter.grad.isfinite().all(), key
        assert parameter.grad.any() or is_before_norm(key), key


def is_before_norm(key: str) -> bool:
    """Whether this is a bias that the BatchNorm behind it takes away again."""
    return key.startswith("point_transforms") and key.endswith("bias") and "norm" not in key


def test_gradient_of_the_whole_head() -> None:
    head = small_head(down=(4,), up=(3,), fuse_after_up=None).double()
    grid = head.grid(cloud(10, extent=0.1))
    assert torch.autograd.gradcheck(lambda f: head(grid, f), features_of(10).double().requires_grad_())


@pytest.mark.parametrize("training", [False, True])
@pytest.mark.parametrize("count", [0, 1])
def test_empty_scan_and_one_point(count: int, training: bool) -> None:
    head = small_head().train(training)
    logits = head(head.grid(cloud(count)), features_of(count))
    assert logits.shape == (count, 3)
    assert logits.isfinite().all()
    logits.sum().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in head.parameters())


def test_points_of_a_voxel_share_the_result_of_the_first() -> None:
    head = small_head()
    xyz = torch.tensor([[0.0, 0, 0], [0.01, 0.01, 0], [1.0, 0, 0]])
    features = features_of(3)
    with torch.no_grad():
        logits = head(head.grid(xyz), features)
        other = head(head.grid(xyz), features + torch.tensor([[0.0], [5.0], [0.0]]))
    assert torch.equal(logits[0], logits[1])
    assert not torch.equal(logits[0], logits[2])
    assert torch.equal(logits, other)


def test_mean_of_the_points_of_a_voxel() -> None:
    head = small_head(reduce="mean")
    xyz = torch.tensor([[0.0, 0, 0], [0.01, 0.01, 0], [1.0, 0, 0]])
    features = features_of(3)
    mean = features[:2].mean(0)
    with torch.no_grad():
        logits = head(head.grid(xyz), features)
        averaged = head(head.grid(xyz), torch.stack([mean, mean, features[2]]))
    torch.testing.assert_close(logits, averaged)


def test_scans_of_a_batch_do_not_meet() -> None:
    head = small_head()
    scans = [cloud(150, 5), cloud(200, 6) + 100, cloud(1, 7), cloud(150, 5)]
    batch = torch.cat([torch.full((len(scan),), i) for i, scan in enumerate(scans)])
    features = [features_of(len(scan)) for scan in scans]
    with torch.no_grad():
        together = head(head.grid(torch.cat(scans), batch), torch.cat(features))
        alone = [head(head.grid(scan), f) for scan, f in zip(scans, features, strict=True)]
    torch.testing.assert_close(together, torch.cat(alone))


def test_order_of_points_does_not_matter_to_the_mean() -> None:
    head, xyz, features = small_head(reduce="mean"), cloud(300), features_of(300)
    order = torch.randperm(300, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        expected = head(head.grid(xyz), features)[order]
        torch.testing.assert_close(head(head.grid(xyz[order]), features[order]), expected)


def test_dropout_in_training_only() -> None:
    xyz, features = cloud(300), features_of(300)
    for dropout, differs in ((0.3, True), (0.0, False)):
        head = small_head(dropout=dropout).train()
        for norm in head.modules():
            if isinstance(norm, RowNorm):
                norm.eval()
        grid = head.grid(xyz)
        with torch.no_grad():
            assert torch.equal(head(grid, features), head.eval()(grid, features)) is not differs


def test_autocast_leaves_the_head_exact() -> None:
    head, xyz, features = small_head(), cloud(100), features_of(100)
    grid = head.grid(xyz)
    with torch.no_grad():
        expected = head(grid, features)
        with torch.autocast("cpu", torch.bfloat16):
            assert torch.equal(head(grid, features), expected)
        assert head(grid, features.half()).dtype == torch.float32


@pytest.mark.parametrize("shape", [(99, 4), (100, 3), (100,)])
def test_features_must_fit(shape: tuple[int, ...]) -> None:
    head = small_head()
    with pytest.raises(ScanError, match=r"features must be \(100, 4\)"):
        head(head.grid(cloud(100)), torch.zeros(shape))

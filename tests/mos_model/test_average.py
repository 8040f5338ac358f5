"""The mean of two checkpoints."""

import pytest
import torch

from mos_model.networks import checkpoint
from mos_model.networks.registry import named_config
from mos_model.tuning.average import write_mean
from runtime.bundle.head_shape import PointHeadConfig
from runtime.errors import CheckpointError
from runtime.sensors.range_image import RangeImage

HEAD = PointHeadConfig(4, (4,), (4,), None, 0.0, 0.4, "mean")


def write(path, seed, channels=4):
    torch.manual_seed(seed)
    config = named_config(
        "rt-head", channels, widths=(4, 4, 4, 4), point_head=HEAD, range_image=RangeImage(height=16, width=64)
    )
    network, head = config.build_image_network(), config.build_point_head()
    checkpoint.save(path, config, network, head, {"step": seed, "resume": {"optimizer": {}}})
    return network, head


def test_every_weight_is_the_mean(tmp_path):
    new, old = write(tmp_path / "new.pt", 1), write(tmp_path / "old.pt", 2)
    write_mean(tmp_path / "new.pt", tmp_path / "old.pt", tmp_path / "mean.pt")
    found = checkpoint.load(tmp_path / "mean.pt")
    assert found.training == {"step": 1}
    for mean, a, b in zip((found.image_net, found.point_head), new, old, strict=True):
        there, other = a.state_dict(), b.state_dict()
        for name, value in mean.state_dict().items():
            torch.testing.assert_close(
                value, there[name] + 0.5 * (other[name] - there[name]) if value.is_floating_point() else there[name]
            )


def test_networks_of_other_shapes_have_none(tmp_path):
    write(tmp_path / "new.pt", 1)
    write(tmp_path / "old.pt", 2, channels=6)
    with pytest.raises(CheckpointError, match="has no mean with"):
        write_mean(tmp_path / "new.pt", tmp_path / "old.pt", tmp_path / "mean.pt")
    assert not (tmp_path / "mean.pt").exists()

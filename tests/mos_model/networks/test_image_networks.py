import math

import pytest
import torch
from torch import nn

from mos_model.networks.config import ModelConfig
from mos_model.networks.registry import named_config, names
from runtime.bundle.residual import Residual
from tests.support import published


def skeleton(config: ModelConfig) -> nn.Module:
    """The network without memory for its weights."""
    with torch.device("meta"):
        return config.build_image_network()


def random_image(config: ModelConfig, batch: int, height: int, width: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(height * width)
    return torch.randn(batch, config.in_channels, height, width, generator=generator)


@pytest.mark.parametrize(("name", "count"), [("v1", 10_413_288), ("lmnet", 6_711_267)])
def test_as_large_as_published(name: str, count: int) -> None:
    assert sum(parameter.numel() for parameter in skeleton(named_config(name)).parameters()) == count


@pytest.mark.parametrize("network", ["image_net", "lmnet"])
def test_same_numbers_as_the_published_network(network: str) -> None:
    net = published.reference_network(network)
    expected = published.reference_output(f"{network}_64x256")
    with torch.no_grad():
        logits, features = net(published.reference_output("image_net_64x256")["input"])
    torch.testing.assert_close(logits.softmax(1), expected["probabilities"], rtol=0, atol=1e-5)
    if "features" in expected:
        torch.testing.assert_close(features, expected["features"], rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", names())
def test_every_parameter_of_every_row_learns(name: str) -> None:
    config = named_config(name, channels=4)
    torch.manual_seed(1)
    net = config.build_image_network().train()
    out = net(random_image(config, 2, 32, 64))
    assert out.logits.shape == (2, 3, 32, 64)
    assert out.features.shape[:3] == (2, 4, 32)
    nn.functional.cross_entropy(out.logits, torch.randint(3, (2, 32, 64))).backward()
    for key, parameter in net.named_parameters():
        assert parameter.grad is not None, key
        assert parameter.grad.isfinite().all(), key


@pytest.mark.parametrize(("name", "share"), [("lmnet", 1), ("rt", 2)])
def test_features_of_pixels(name: str, share: int) -> None:
    """Features of a pixel are those in its place of the feature map, which may be narrower than the image."""
    config = named_config(name, channels=4)
    with torch.no_grad():
        out = config.build_image_network().eval()(random_image(config, 2, 16, 32))
    assert out.features.shape == (2, 4, 16, 32 // share)
    v, u = torch.tensor([0, 3, 3, 15]), torch.tensor([0, 6, 7, 31])
    found = out.features_at(1, v * 32 + u)
    assert torch.equal(found, out.features[1][:, v, u // share].T)


@pytest.mark.parametrize("name", ["v1", "lmnet"])
def test_other_widths(name: str) -> None:
    config = named_config(name, channels=16)
    net = config.build_image_network().eval()
    with torch.no_grad():
        out = net(random_image(config, 1, 16, 32))
    assert out.features.shape == (1, 16, 16, 32)
    assert out.logits.isfinite().all()


@pytest.mark.parametrize(("height", "width"), [(64, 2048), (32, 1024), (128, 1024), (16, 16)])
def test_any_sensor(height: int, width: int) -> None:
    config = named_config("v1", channels=2)
    net = config.build_image_network().eval()
    with torch.no_grad():
        out = net(random_image(config, 1, height, width))
    assert out.logits.shape == (1, 3, height, width)
    assert out.logits.isfinite().all()


@pytest.mark.parametrize("name", ["v1", "lmnet"])
def test_fewer_residuals(name: str) -> None:
    config = named_config(name, channels=4, residual=Residual((1, 4, 8)))
    net = config.build_image_network().eval()
    assert net(random_image(config, 1, 16, 16)).logits.shape == (1, 3, 16, 16)


def test_meta_kernel_only_where_the_row_has_it() -> None:
    has = {row: any("meta_kernel" in key for key in skeleton(named_config(row)).state_dict()) for row in "bcde"}
    assert has == {"b": False, "c": False, "d": True, "e": True}


def test_dropout_where_it_was_published() -> None:
    for name in ("v1", "lmnet"):
        dropouts = {
            key: module.p
            for key, module in skeleton(named_config(name, channels=4)).named_modules()
            if isinstance(module, nn.Dropout2d)
        }
        without = {"encoder.0.dropout", "motion_encoder.0.dropout", "decoder.3.dropout"} & dropouts.keys()
        assert {key for key, p in dropouts.items() if p == 0} == without
        assert {p for key, p in dropouts.items() if key not in without} == {0.2}


def test_all_norms_have_the_published_epsilon() -> None:
    norms = [m for m in skeleton(named_config("v1")).modules() if isinstance(m, nn.BatchNorm2d)]
    assert {norm.eps for norm in norms} == {1e-5}


def test_images_of_a_batch_do_not_meet_in_evaluation() -> None:
    config = named_config("v1", channels=4)
    net = config.build_image_network().eval()
    images = random_image(config, 2, 16, 32)
    with torch.no_grad():
        together, alone = net(images).logits, net(images[1:]).logits
    torch.testing.assert_close(together[1:], alone)


def test_bfloat16_autocast_is_close() -> None:
    config = named_config("v1", channels=8)
    torch.manual_seed(2)
    net = config.build_image_network().eval()
    image = random_image(config, 1, 16, 64)
    with torch.no_grad():
        exact = net(image).logits.softmax(1)
        with torch.autocast("cpu", torch.bfloat16):
            rounded = net(image).logits.softmax(1)
    assert (exact - rounded).abs().max() < 0.05


def test_point_head_only_where_the_configuration_has_one() -> None:
    assert named_config("v1").build_point_head() is None
    with torch.device("meta"):
        head = named_config("v2-lite", channels=16).build_point_head()
    assert head is not None
    assert math.prod(head.stem.kernel.shape) == 27 * 16 * 16

import math

import pytest
import torch
from torch import nn

from mos_model.networks.config import NAMES, ModelConfig, named_config
from mos_model.networks.network import UNUSED_PREFIXES, build_image_network, build_point_head
from runtime.bundle.residual import Residual
from tests.support import published

PAPER_ROWS = [name for name in NAMES if name != "rt"]


def skeleton(config: ModelConfig) -> nn.Module:
    """The network without memory for its weights."""
    with torch.device("meta"):
        return build_image_network(config)


def random_image(config: ModelConfig, batch: int, height: int, width: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(height * width)
    return torch.randn(batch, config.in_channels, height, width, generator=generator)


@pytest.mark.parametrize(("name", "network", "count"), [("v1", "image_net", 10_413_288), ("lmnet", "lmnet", 6_711_267)])
def test_names_and_shapes_are_the_published_ones(name: str, network: str, count: int) -> None:
    net = skeleton(named_config(name))
    expected = {key: s for key, s in published.layout(network).items() if not key.startswith(UNUSED_PREFIXES)}
    assert {key: tuple(value.shape) for key, value in net.state_dict().items()} == expected
    assert sum(parameter.numel() for parameter in net.parameters()) == count


def test_unused_prefixes_all_occur() -> None:
    keys = published.layout("image_net")
    assert all(any(key.startswith(prefix) for key in keys) for prefix in UNUSED_PREFIXES)


@pytest.mark.parametrize(
    ("name", "network", "output"),
    [("v1", "image_net", "image_net_64x256"), ("lmnet", "lmnet", "lmnet_64x256")],
)
def test_same_numbers_as_the_published_network(name: str, network: str, output: str) -> None:
    state = published.reference_state(network)
    net = build_image_network(named_config(name)).eval()
    net.load_state_dict({key: value for key, value in state.items() if not key.startswith(UNUSED_PREFIXES)})
    expected = published.reference_output(output)
    with torch.no_grad():
        logits, features = net(published.reference_output("image_net_64x256")["input"])
    torch.testing.assert_close(logits.softmax(1), expected["probabilities"], rtol=0, atol=1e-5)
    if "features" in expected:
        torch.testing.assert_close(features, expected["features"], rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", PAPER_ROWS)
def test_every_parameter_of_every_row_learns(name: str) -> None:
    config = named_config(name, channels=4)
    torch.manual_seed(1)
    net = build_image_network(config).train()
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
        out = build_image_network(config).eval()(random_image(config, 2, 16, 32))
    assert out.features.shape == (2, 4, 16, 32 // share)
    v, u = torch.tensor([0, 3, 3, 15]), torch.tensor([0, 6, 7, 31])
    found = out.features_at(1, v * 32 + u)
    assert torch.equal(found, out.features[1][:, v, u // share].T)


@pytest.mark.parametrize("name", ["v1", "lmnet"])
def test_other_widths(name: str) -> None:
    config = named_config(name, channels=16)
    net = build_image_network(config).eval()
    with torch.no_grad():
        out = net(random_image(config, 1, 16, 32))
    assert out.features.shape == (1, 16, 16, 32)
    assert out.logits.isfinite().all()


@pytest.mark.parametrize(("height", "width"), [(64, 2048), (32, 1024), (128, 1024), (16, 16)])
def test_any_sensor(height: int, width: int) -> None:
    config = named_config("v1", channels=2)
    net = build_image_network(config).eval()
    with torch.no_grad():
        out = net(random_image(config, 1, height, width))
    assert out.logits.shape == (1, 3, height, width)
    assert out.logits.isfinite().all()


@pytest.mark.parametrize("name", ["v1", "lmnet"])
def test_fewer_residuals(name: str) -> None:
    config = named_config(name, channels=4, residual=Residual((1, 4, 8)))
    net = build_image_network(config).eval()
    assert net(random_image(config, 1, 16, 16)).logits.shape == (1, 3, 16, 16)


def test_meta_kernel_only_where_the_row_has_it() -> None:
    has = {row: any("metaConv" in key for key in skeleton(named_config(row)).state_dict()) for row in "bcde"}
    assert has == {"b": False, "c": False, "d": True, "e": True}


def test_dropout_where_it_was_published() -> None:
    for name in ("v1", "lmnet"):
        dropouts = {
            key: module.p
            for key, module in skeleton(named_config(name, channels=4)).named_modules()
            if isinstance(module, nn.Dropout2d)
        }
        without = {"resBlock1.dropout", "RI_resBlock1.dropout", "upBlock4.dropout"} & dropouts.keys()
        assert {key for key, p in dropouts.items() if p == 0} == without
        assert {p for key, p in dropouts.items() if key not in without} == {0.2}


def test_all_norms_have_the_published_epsilon() -> None:
    norms = [m for m in skeleton(named_config("v1")).modules() if isinstance(m, nn.BatchNorm2d)]
    assert {norm.eps for norm in norms} == {1e-5}


def test_images_of_a_batch_do_not_meet_in_evaluation() -> None:
    config = named_config("v1", channels=4)
    net = build_image_network(config).eval()
    images = random_image(config, 2, 16, 32)
    with torch.no_grad():
        together, alone = net(images).logits, net(images[1:]).logits
    torch.testing.assert_close(together[1:], alone)


def test_bfloat16_autocast_is_close() -> None:
    config = named_config("v1", channels=8)
    torch.manual_seed(2)
    net = build_image_network(config).eval()
    image = random_image(config, 1, 16, 64)
    with torch.no_grad():
        exact = net(image).logits.softmax(1)
        with torch.autocast("cpu", torch.bfloat16):
            rounded = net(image).logits.softmax(1)
    assert (exact - rounded).abs().max() < 0.05


def test_point_head_only_where_the_configuration_has_one() -> None:
    assert build_point_head(named_config("v1")) is None
    with torch.device("meta"):
        head = build_point_head(named_config("v2-lite", channels=16))
    assert head is not None
    assert math.prod(head.stem[0].kernel.shape) == 27 * 16 * 16

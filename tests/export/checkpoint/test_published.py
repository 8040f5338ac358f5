"""Checkpoints of this package and published ones: what they are is seen from keys and shapes."""

import argparse

import pytest
import torch
from torch import nn

from export.checkpoint.key_map import (
    UNUSED_PREFIXES,
    head_modules,
    image_modules,
    published_names,
    under_our_names,
)
from export.checkpoint.published import understand
from export.checkpoint.reader import read_tensors
from mos_model.networks import checkpoint
from mos_model.networks.point_head import PointHead
from mos_model.networks.registry import named_config
from runtime.bundle.head_shape import FULL, LITE, PointHeadConfig
from runtime.bundle.residual import Residual
from runtime.errors import CheckpointError, SettingError
from tests.support.published import layout

SMALL = {
    "v2": PointHeadConfig(in_channels=4, down=(4, 6, 8, 10), up=(10, 8, 6, 6)),
    "v2-lite": PointHeadConfig(in_channels=4, down=(6, 8), up=(6, 6), fuse_after_up=None, dropout=0.0),
}


def small_state(name, **changes):
    """A network of 4 channels and its weights, random also where initialisation is not."""
    config = named_config(name, 4, **changes)
    return published(randomised(config.build_image_network()), image_modules(config.kind))


def small_head(name):
    return published(randomised(PointHead(SMALL[name])), head_modules(SMALL[name]))


def published(state, modules):
    """A state dict of ours under the published names."""
    names = published_names(state, modules)
    return {names[key]: value for key, value in state.items()}


def published_state(network):
    """Weights under the published keys and shapes."""
    return {
        key: torch.tensor(7) if key.endswith("num_batches_tracked") else torch.rand(shape)
        for key, shape in layout(network).items()
    }


def randomised(network: nn.Module):
    state = network.state_dict()
    for value in state.values():
        if value.is_floating_point():
            value.uniform_(0.5, 1.5)
    return state


def prefixed(state):
    return {f"module.{key}": value for key, value in state.items()}


def read_checkpoint(path, network=None):
    return understand(read_tensors(path), path, network)


def write(path, content):
    torch.save(content, path)
    return path


def assert_loaded(network: nn.Module, state):
    """Whether a network holds what a published state dict holds."""
    if isinstance(network, PointHead):
        state = under_our_names(state, head_modules(network.config))
    else:
        state = under_our_names(state, image_modules("dual" if "logits3.weight" in state else "lmnet"))
    own = network.state_dict()
    assert not network.training
    assert own.keys() == state.keys()
    for key, value in own.items():
        assert torch.equal(value, state[key]), key


@pytest.mark.parametrize("wrap", [lambda state: state, prefixed], ids=["plain", "module."])
def test_stage_1_with_training_objects(tmp_path, wrap):
    state = published_state("image_net")
    content = {
        "state_dict": wrap(state),
        "epoch": 3,
        "lr": 0.1,
        "bad": float("nan"),
        "args": argparse.Namespace(),
    }
    read = read_checkpoint(write(tmp_path / "stage_1", content))
    assert read.config == named_config("v1")
    assert_loaded(read.image_net, state)
    assert read.point_head is None
    assert sorted(read.dropped) == sorted(key for key in state if key.startswith(UNUSED_PREFIXES))
    assert len(read.dropped) > 100


@pytest.mark.parametrize(
    ("name", "head", "keys"), [("v2", FULL, "point_head_full"), ("v2-lite", LITE, "point_head_lite")]
)
def test_stage_2_of_published_shapes(tmp_path, name, head, keys):
    main, refine = published_state("image_net"), published_state(keys)
    content = {"main_state_dict": main, "refine_state_dict": refine, "optimizer": argparse.Namespace()}
    read = read_checkpoint(write(tmp_path / "stage_2", content))
    assert read.config == named_config(name)
    assert read.config.point_head == head
    assert_loaded(read.image_net, main)
    assert_loaded(read.point_head, refine)


@pytest.mark.parametrize("name", ["v2", "v2-lite"])
@pytest.mark.parametrize("wrap", [lambda state: state, prefixed], ids=["plain", "module."])
def test_stage_2_of_other_widths(tmp_path, name, wrap):
    main, refine = small_state("v1"), small_head(name)
    file = write(tmp_path / "file", {"main_state_dict": wrap(main), "refine_state_dict": wrap(refine)})
    read = read_checkpoint(file)
    assert read.config == named_config(name, 4, point_head=SMALL[name])
    assert_loaded(read.point_head, refine)
    assert not read.dropped


@pytest.mark.parametrize("lags", [1, 4, 8])
def test_lmnet_with_any_number_of_residual_images(tmp_path, lags):
    residual = Residual(lags=tuple(range(1, lags + 1)))
    state = small_state("lmnet", residual=residual)
    read = read_checkpoint(write(tmp_path / "file", {"state_dict": state}))
    assert read.config == named_config("lmnet", 4, residual=residual)
    assert_loaded(read.image_net, state)


def test_lmnet_of_published_shapes(tmp_path):
    state = published_state("lmnet")
    read = read_checkpoint(write(tmp_path / "file", {"state_dict": state}))
    assert read.config == named_config("lmnet")
    assert_loaded(read.image_net, state)


def test_weights_alone_and_other_numbers_of_residual_images(tmp_path):
    residual = Residual(lags=(1, 2, 3))
    state = small_state("v1", residual=residual)
    read = read_checkpoint(write(tmp_path / "file", state))
    assert read.config == named_config("v1", 4, residual=residual)
    assert_loaded(read.image_net, state)


@pytest.mark.parametrize(
    ("stored", "asked", "expected"),
    [
        ("v1", "e", "v1"),
        ("v1", "v1", "v1"),
        ("d", "d", "d"),
        ("b", "b", "b"),
        ("c", "c", "c"),
        ("lmnet", "lmnet", "lmnet"),
    ],
)
def test_the_pooling_is_what_the_caller_says(tmp_path, stored, asked, expected):
    file = write(tmp_path / "file", {"state_dict": small_state(stored)})
    assert read_checkpoint(file, asked).config == named_config(expected, 4)


def test_a_point_head_comes_along_with_each_row(tmp_path):
    content = {"main_state_dict": small_state("d"), "refine_state_dict": small_head("v2-lite")}
    read = read_checkpoint(write(tmp_path / "file", content), "d")
    assert read.config == named_config("d", 4, point_head=SMALL["v2-lite"])
    assert read.point_head is not None
    assert read_checkpoint(tmp_path / "file", "v2-lite").config.name == "v2-lite"


@pytest.mark.parametrize(
    ("stored", "asked", "message"),
    [
        ("b", None, "b .average pooling. or c: say which"),
        ("c", None, "b .average pooling. or c: say which"),
        ("b", "v1", "those of b or c, not of v1"),
        ("v1", "b", "not of b"),
        ("v1", "lmnet", "not of lmnet"),
        ("lmnet", "c", "those of lmnet, not of c"),
        ("v1", "v2", "it is v1, not v2"),
    ],
)
def test_another_network_than_the_file_holds_is_an_error(tmp_path, stored, asked, message):
    file = write(tmp_path / "file", {"state_dict": small_state(stored)})
    with pytest.raises(CheckpointError, match=message):
        read_checkpoint(file, asked)


def test_the_wrong_head_and_an_unknown_network_are_errors(tmp_path):
    content = {"main_state_dict": small_state("v1"), "refine_state_dict": small_head("v2")}
    file = write(tmp_path / "file", content)
    with pytest.raises(CheckpointError, match="it is v2, not v2-lite"):
        read_checkpoint(file, "v2-lite")
    with pytest.raises(SettingError, match="v2-lite, not 'v3'"):
        read_checkpoint(file, "v3")


def test_every_missing_extra_and_misshapen_key_is_named(tmp_path):
    state = small_state("v1")
    del state["downCntx.conv1.weight"], state["resBlock2.bn1.bias"]
    state["resBlock3.conv9.weight"] = torch.ones(1)
    state["logits3.bias"] = torch.ones(20)
    # What tells the width is missing: the published width stands in, and all is named against it.
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(write(tmp_path / "file", {"state_dict": state}))
    message = str(caught.value)
    for part in (
        "downCntx.conv1.weight is missing",
        "resBlock2.bn1.bias is missing",
        "resBlock3.conv9.weight is not part",
        "logits3.bias is (20,) instead of (3,)",
    ):
        assert part in message


def test_every_wrong_key_of_the_point_head_is_named(tmp_path):
    head = small_head("v2")
    head["stage4.2.net.3.kernel"] = argparse.Namespace()
    head["classifier.0.bias"] = torch.ones(4)
    content = {"main_state_dict": small_state("v1"), "refine_state_dict": head}
    with pytest.raises(CheckpointError, match="point head") as caught:
        read_checkpoint(write(tmp_path / "file", content))
    assert "stage4.2.net.3.kernel is no tensor" in str(caught.value)
    assert "classifier.0.bias is (4,) instead of (3,)" in str(caught.value)


def test_other_heads_and_networks_are_named(tmp_path):
    three = {key: value for key, value in small_head("v2").items() if not key.startswith("stage4")}
    content = {"main_state_dict": small_state("v1"), "refine_state_dict": three}
    with pytest.raises(CheckpointError, match="3 stages"):
        read_checkpoint(write(tmp_path / "file", content))
    with pytest.raises(CheckpointError, match="refine_state_dict should be a mapping"):
        read_checkpoint(write(tmp_path / "file", {"main_state_dict": small_state("v1")}))
    with pytest.raises(CheckpointError, match=r"no network of this family.*fc\.weight"):
        read_checkpoint(write(tmp_path / "file", {"state_dict": {"fc.weight": torch.ones(2)}}))
    with pytest.raises(CheckpointError, match=r"no known kind of checkpoint.*found model, epoch"):
        read_checkpoint(write(tmp_path / "file", {"model": {}, "epoch": 1}))
    with pytest.raises(CheckpointError, match=r"no known kind of checkpoint.*found nothing"):
        read_checkpoint(write(tmp_path / "file", {}))
    with pytest.raises(CheckpointError, match="should be a mapping"):
        read_checkpoint(write(tmp_path / "file", {"state_dict": {0: torch.ones(1)}}))
    odd = small_state("v1") | {"downCntx.conv1.weight": torch.ones(3, 5, 1, 1)}
    with pytest.raises(CheckpointError, match="even"):
        read_checkpoint(write(tmp_path / "file", {"state_dict": odd}))


def test_weights_that_are_not_finite_are_an_error(tmp_path):
    state = small_state("lmnet")
    state["logits.bias"][0] = float("nan")
    with pytest.raises(CheckpointError, match=r"logits.bias is not finite"):
        read_checkpoint(write(tmp_path / "file", {"state_dict": state}))


def test_our_own_checkpoint(tmp_path):
    config = named_config("v2-lite", 4, point_head=SMALL["v2-lite"])
    image_net, head = config.build_image_network(), config.build_point_head()
    training = {"step": 5, "optimizer": {"momentum": torch.ones(2)}}
    checkpoint.save(tmp_path / "own", config, image_net, head, training)
    read = read_checkpoint(tmp_path / "own")
    assert read.config == config
    for found, made in ((read.image_net, image_net), (read.point_head, head)):
        assert not found.training
        assert all(torch.equal(value, made.state_dict()[key]) for key, value in found.state_dict().items())
    assert read.origin == "checkpoint of lidar-mos"
    assert read.training["step"] == 5
    with pytest.raises(CheckpointError, match=r"leave out .*`network`"):
        read_checkpoint(tmp_path / "own", "v1")

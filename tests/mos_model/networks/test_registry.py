"""Configurations by name and from files; a new network is one file and one line."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from export.bundle import parity
from export.convert import export_checkpoint
from mos_model.networks import checkpoint, registry
from mos_model.networks.dual import DualConfig
from mos_model.networks.registry import named_config, names, read_config
from mos_model.simulator import simulate
from mos_model.training.distributed import Ranks
from mos_model.training.progress import Display
from mos_model.training.recipe import recipe
from mos_model.training.tasks import ImageTask
from mos_model.training.trainer import Limits, Trainer
from runtime.bundle.head_shape import FULL, LITE
from runtime.bundle.residual import Residual
from runtime.errors import SettingError
from runtime.runner import MosRunner
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import SENSORS
from tests.support.paths import ROOT
from tests.support.training import IMAGE, Patches


def test_names_of_mos_train() -> None:
    assert set(names()) == {
        "lmnet",
        "b",
        "c",
        "d",
        "e",
        "v1",
        "v2",
        "v2-lite",
        "rt",
        "rt-head",
        "limoseg",
        "cylinder3d",
    }
    (row,) = re.findall(r"^\| `--config` \|(.+)$", (ROOT / "mos_model" / "README.md").read_text(), re.MULTILINE)
    assert re.findall(r"`([\w-]+)`", row) == names()


@pytest.mark.parametrize("channels", [32, 16])
@pytest.mark.parametrize("name", names())
def test_round_trip_through_json(name: str, channels: int) -> None:
    config = named_config(name, channels)
    assert read_config(json.loads(json.dumps(config.to_dict()))) == config
    assert json.loads(json.dumps(config.to_dict())) == config.to_dict()


def test_round_trip_of_everything_changed() -> None:
    config = named_config(
        "rt",
        channels=24,
        name="small",
        sensor="vlp16",
        range_image=RangeImage(32, 1024, 10.0, -30.0),
        residual=Residual((1, 4), kind="signed"),
        point_head=LITE,
        widths=(16, 32, 64),
    )
    assert read_config(config.to_dict()) == config


def test_rows_of_the_ablation_table() -> None:
    rows = {name: named_config(name) for name in "bcde"}
    assert [(row.pooling, row.meta_kernel) for row in rows.values() if isinstance(row, DualConfig)] == [
        ("average", False),
        ("soft", False),
        ("average", True),
        ("soft", True),
    ]
    assert named_config("lmnet").to_dict()["pooling"] == "average"
    assert named_config("v2").point_head == FULL
    assert named_config("v2-lite").point_head == LITE
    assert named_config("v1").point_head is None
    assert named_config("v1") == DualConfig()
    assert named_config("rt").residual == Residual(kind="signed")


def test_head_follows_channels_and_keeps_its_own() -> None:
    head = named_config("lmnet", channels=8, point_head=FULL).point_head
    assert head is not None
    assert (head.in_channels, head.down, head.up) == (8, FULL.down, FULL.up)


def test_unknown_names_and_settings() -> None:
    with pytest.raises(SettingError, match="v2-lite"):
        named_config("v3")
    with pytest.raises(SettingError, match="network 'rt' has no setting meta_kernel, pooling"):
        named_config("rt", pooling="soft", meta_kernel=True)


@pytest.mark.parametrize("part", [None, "range_image", "residual", "point_head"])
def test_unknown_keys_are_named(part: str | None) -> None:
    values = named_config("v2").to_dict()
    (values if part is None else values[part])["colour"] = 1
    with pytest.raises(SettingError, match=rf"model.*{part or ''}.*: unknown entry colour"):
        read_config(values)


@pytest.mark.parametrize(
    "values",
    [
        [],
        None,
        {"channels": "32"},
        {"sensor": 3},
        {"sensor": "hdl65"},
        {"sensor": {"std": 5}},
        {"range_image": {"std": 5}},
        {"kind": "unet"},
        {"kind": [1]},
    ],
)
def test_wrong_types_raise_setting_errors(values: object) -> None:
    with pytest.raises(SettingError):
        read_config(values)


def test_missing_keys_take_defaults() -> None:
    assert read_config({"name": "v1"}) == DualConfig()


def test_a_new_network_is_one_file(
    contributed: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As CONTRIBUTING says: it trains, is exported and runs."""
    new = contributed("mos_model/networks/pixel.py").PixelConfig
    monkeypatch.setitem(registry.NETWORKS, new.kind, new)
    config = named_config("pixel-wide", channels=4, range_image=IMAGE)
    assert config.to_dict()["size"] == 5
    assert {"pixel", "pixel-wide"} < set(names())
    task = ImageTask(config, torch.tensor([0.0, 1.0, 3.0]), torch.device("cpu"))
    before = task.trained.state_dict()["logits.weight"].clone()
    steps = recipe("sim2real", steps=2, batch=2, crop=0, mix=1)
    trainer = Trainer(task, steps, Patches(), None, tmp_path, ranks=Ranks(torch.device("cpu")), workers=0)
    with Display(tmp_path, quiet=True) as display:
        trainer.run(Limits(), display)
    found = checkpoint.load(tmp_path / "last.pt")
    assert found.config == config
    assert not torch.equal(found.image_net.state_dict()["logits.weight"], before)
    # A tenth of the sensor's columns, to be quick.
    thin = replace(SENSORS["hdl64e"], azimuth_steps=200)
    monkeypatch.setattr(parity, "simulate", lambda seed, frames, _, **more: simulate(seed, frames, thin, **more))
    made = export_checkpoint(tmp_path / "last.pt", tmp_path / "bundle").bundle.manifest
    assert (made.network, read_config(made.model)) == ("pixel", config)
    with MosRunner(tmp_path / "bundle", threads=1) as runner:
        points = np.random.default_rng(0).uniform(-20, 20, (500, 4)).astype(np.float32)
        assert runner(points, np.eye(4)).moving.shape == (500,)
